"""The page of `wavefield look` in one browser tab: controls, panels and the verdict on the cube's quality."""

import re
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.layouts import column, row
from bokeh.models import Button, CustomJS, NumericInput, Select, Slider, Toggle
from markupsafe import Markup

from wavefield.errors import WavefieldError
from wavefield.explorer import parts
from wavefield.explorer.map import MapPanel
from wavefield.explorer.node import NodePanel
from wavefield.explorer.parts import OVERLAYS, TABS, LazyPanel, Place
from wavefield.explorer.record import LookSession
from wavefield.figures.display import display
from wavefield.store.verdict import WORDS, read_verdict
from wavefield.text import spell_time
from wavefield.variables import FrameStatus

if TYPE_CHECKING:
    import xarray as xr

PICKED = ("node", "mask")  # second group of tabs, next to the group `TABS`
DRAGS = [("move", "pan"), ("mask", "mask")]  # what clicks do: value and label of the options
_RECHECK_MS = 2000  # between looks at the status of steps while a cube is being written
_STATUS_WORDS = {
    FrameStatus.NOT_STARTED: " – not measured yet",
    FrameStatus.FAILED: " – this step could not be measured",
    FrameStatus.DISCONTINUOUS: " – a frame was lost, doubled or late here; the step is left out",
}
_COLOURS = {"note": "#00664b", "remark": "#7a5200", "grave": "#a83d00"}
_CODE = re.compile(r"`([^`]+)`")
_STEP = "step.value = Math.max(step.start, Math.min(step.end, step.value + by))"
_LINK = 'history.replaceState(null, "", location.pathname + "?" + cb_obj.text)'
_WRAP = {"flex-wrap": "wrap"}


class LookPage:
    """The page of a cube in one browser tab. `place` is the state (variable, step, ...) in which it opens."""

    def __init__(self, session: LookSession, place: Place) -> None:
        self.session, self.place = session, place
        record = session.record
        self.map, self.node = MapPanel(record, self._clicked), NodePanel(record)
        # OpenCV and others take a second to import, so these panels wait until their tab is opened
        chosen = self.pick, self._take_corner, lambda: self._soon(self._show_view)
        self.cameras = LazyPanel("cameras", "CameraPanel", session, *chosen)
        self.waves = LazyPanel("waves", "WavePanel", session)
        self.masks = LazyPanel("cameras", "MaskPanel", self._masks_changed)
        self._views = {"cameras": self.cameras, "waves": self.waves}
        bodies = [self.map.layout, *(panel.body for panel in self._views.values())]
        titles = [tab.capitalize() for tab in TABS]
        self.views = parts.make_tabs("views", TABS.index(place.tab), titles, bodies)
        bodies = [self.node.layout, self.masks.body]
        self.picked = parts.make_tabs("picked", 0, [kind.capitalize() for kind in PICKED], bodies)
        self._make_controls()
        self._make_head()
        self._listen()
        self._document: Document | None = None
        self._scheduled: set[str] = set()  # names of the drawings to be done
        self._chunks_shown = -1  # number of chunks of the preview when series were last drawn
        self._status_shown = -1  # status of the step on the map when it was last drawn
        self._setting_limits = False  # True while the program, not the reader, sets them

    # -- what is on the page ---------------------------------------------------------------------------

    def _make_controls(self) -> None:
        record, place, low = self.session.record, self.place, {"align": "end"}
        names = parts.named(record.names)
        above = [
            Select(name="show", title="Map of", value=place.show, options=names, width=175),
            Button(name="back", label="◀", width=40, **low),
            Toggle(name="play", label="Play", width=70, **low),
            Button(name="forward", label="▶", width=40, **low),
            Slider(
                name="step", title="Step", start=0, end=max(record.layout.steps - 1, 1), value=place.step,
                step=1, sizing_mode="stretch_width", show_value=False, min_width=240,
            ),
        ]  # fmt: skip
        below = [
            NumericInput(name="low", title="Colours from", mode="float", width=90),
            NumericInput(name="high", title="to", mode="float", width=80),
            Button(name="fit", label="Fit", width=46, **low),
            Select(name="overlay", title="Overlay", value=place.overlay, options=list(OVERLAYS), width=115),
            Select(name="drag", title="Clicks", value="move", options=DRAGS, width=105),
        ]
        self.controls = {str(one.name): one for one in (*above, *below)}
        self.of_scale = below[:3]
        for name, by in (("back", -1), ("forward", 1)):
            step = CustomJS(args={"step": self.controls["step"], "by": by}, code=_STEP)
            self.controls[name].js_on_click(step)
        play = CustomJS(
            args={name: self.controls[name] for name in ("play", "step")}, code=parts.asset("play.js")
        )
        self.controls["play"].js_on_change("active", play)
        self.map.sources["image"].js_on_change("data", play)
        self.link = parts.text_line("link", place.query())
        self.link.visible = False
        self.link.js_on_change("text", CustomJS(code=_LINK))
        wide = {"sizing_mode": "stretch_width"}
        self.top = column(row(*above, **wide, styles=_WRAP), self.link, name="controls", **wide)
        self.options = row(*below, name="options", **wide, styles=_WRAP)

    def _make_head(self) -> None:
        self.trouble = ""  # why something of the experiment is not shown
        self._error = ""  # error of the last drawing, as HTML
        self.state = parts.text_line("state_words", html=True)
        self.verdict = parts.text_line("verdict_words", html=True)
        for words in (self.state, self.verdict):
            words.sizing_mode = None  # as wide as the text
        wrap = {"flex-wrap": "wrap", "column-gap": "24px"}
        self.head = row(self.state, self.verdict, name="state", sizing_mode="stretch_width", styles=wrap)

    def _listen(self) -> None:
        for name in ("show", "step", "overlay"):
            self.controls[name].on_change("value", lambda a, o, new, name=name: self._entered(name))
        for name in ("low", "high"):
            self.controls[name].on_change("value", lambda a, o, new: self._limits_entered())
        self.controls["drag"].on_change("value", lambda a, o, new: self._open_masks())
        self.controls["fit"].on_click(self._fit)
        self.views.on_change("active", lambda a, o, new: self.change(tab=TABS[int(new)]))
        self.picked.on_change("active", lambda a, o, new: self._soon(self._show_picked))

    def attach(self, document: Document) -> None:
        """Add the page to a Bokeh document, which from then on calls `recheck` every two seconds."""
        self._document = document
        roots = self.top, self.options, self.views, self.picked
        for root in (self.head, *roots):
            document.add_root(root)
        names = [str(root.name) for root in roots]
        aspect = float(self.map.layout.aspect_ratio)
        parts.apply_template(
            document, str(self.session.record.group.attrs["experiment"]), "look", names, aspect=aspect
        )
        document.add_periodic_callback(self.recheck, _RECHECK_MS)
        self._show_head()
        self.redraw()
        if document.session_context is None:  # no browser will report that it is ready
            self._show_context()
        else:
            document.on_event(DocumentReady, lambda event: self._ready())

    def _ready(self) -> None:
        """Show the picked node, and then probes, masks and verdict, which a thread takes a second to load."""
        self._soon(self._show_picked)

        def read() -> None:
            with suppress(WavefieldError):  # shown by `_show_context`
                self.session.run.probes  # noqa: B018
            if self._document is not None:
                self._document.add_next_tick_callback(self._show_context)

        threading.Thread(target=read, daemon=True, name="context").start()

    def _show_context(self) -> None:
        """Show the probes, masks and verdict of the cube; an error in one of them is shown as a sentence."""
        run = self.session.run
        try:
            if run.probes is not None:
                self._show_probes(run.probes)
            elif run.experiment is not None and run.experiment.probes is not None:
                self.trouble = run.reason("probes")
        except WavefieldError as error:
            self.trouble = f"no probes: {error}"
        self._guarded(self._show_masks)
        self._show_verdict()
        self._show_head()
        self._soon(self._show_picked)

    def _show_probes(self, probes: "xr.Dataset") -> None:
        """Draw the probes on the map, and give them to the node panel for comparison.
        The message `trouble` gets the names of probes outside the map or without a position."""
        record = self.session.record
        names, x, y = probes.probe.values.astype(str), probes.probe_x.values, probes.probe_y.values
        self.node.probes = probes
        inside = (x >= record.x[0]) & (x <= record.x[-1]) & (y >= record.y[0]) & (y <= record.y[-1])
        self.map.mark_probes(list(names[inside]), x[inside], y[inside])
        placed = np.isfinite(x) & np.isfinite(y)
        for words, which in (("outside the map", placed & ~inside), ("without a place", ~placed)):
            if which.any():
                self.trouble += f"{'; ' if self.trouble else ''}probes {words}: {', '.join(names[which])}"

    # -- actions of the reader -------------------------------------------------------------------------

    def change(self, **changed: Any) -> None:
        """Change fields of the page's state, by name (step, show, tab, ...), and redraw the page."""
        place = replace(self.place, **changed)
        if place != self.place:
            self.place = place
            self._soon(self._show_view if list(changed) == ["tab"] else self.redraw)

    def entered(self, name: str) -> str | int:
        """Return the value of the control `name`: the option chosen in a menu, or a step within the cube."""
        widget = self.controls[name]
        if isinstance(widget, Select):
            return parts.chosen(widget)
        return int(min(max(widget.value, 0), self.session.record.layout.steps - 1))

    def _entered(self, name: str) -> None:
        changed: dict[str, Any] = {name: self.entered(name)}
        if name == "show":  # each variable has its own colour scale
            changed["limits"] = None
        self.change(**changed)

    def _clicked(self, x: float, y: float) -> None:
        """Handle a click on the map at x, y, m: add a corner if the user draws masks, else pick the node."""
        from wavefield.series.masks import WATER

        if not self._take_corner(WATER, x, y):
            self.pick(x, y)

    def pick(self, x: float, y: float) -> None:
        """Select the grid node nearest to x, y, metres, on the water surface, and show its values."""
        self.place = replace(self.place, node=(x, y))
        self.picked.active = PICKED.index("node")
        self.map.mark(self.place.node)
        self._soon(self._show_picked)
        if self.place.tab == "cameras":
            self._soon(self._show_view)

    def _open_masks(self) -> None:
        if self.entered("drag") == "mask":
            self.picked.active = PICKED.index("mask")

    def _take_corner(self, image: str, x: float, y: float) -> bool:
        """Add a corner x, y to a mask if the user draws masks; return whether it was added.
        `image` names the mask: a camera (x and y in px) or `WATER` (x and y in m)."""
        if self.entered("drag") != "mask":
            return False
        self._open_masks()
        self.masks().add(image, (x, y))
        return True

    def _masks_changed(self) -> None:
        self._show_masks()
        if self.place.tab == "cameras":
            self._soon(self._show_view)

    def _limits_entered(self) -> None:
        low, high = self.controls["low"].value, self.controls["high"].value
        if self._setting_limits or low is None or high is None or not low < high:
            return
        if (low, high) != self.map.limits(self.place):
            self.change(limits=(float(low), float(high)))

    def _fit(self) -> None:
        self.map.refit(self.place)
        self.place = replace(self.place, limits=None)
        self._soon(self.redraw)

    # -- drawing ---------------------------------------------------------------------------------------

    def _soon(self, draw: Callable[[], None]) -> None:
        """Schedule a call of `draw` for the next tick of the server, unless it is scheduled already."""
        name = draw.__name__
        if self._document is None or name in self._scheduled:
            return
        self._scheduled.add(name)

        def run() -> None:
            self._scheduled.discard(name)
            self._guarded(draw)

        self._document.add_next_tick_callback(run)

    def _guarded(self, draw: Callable[[], None]) -> None:
        """Call `draw`; if it raises a WavefieldError, show the message on the page."""
        try:
            draw()
        except WavefieldError as error:
            self._error = parts.alert(error)
            self._show_head()

    def redraw(self) -> None:
        """Draw the map, the controls and the open tabs for the present state of the page."""
        step, record = self.place.step, self.session.record
        if self._error:
            self._error = ""
            self._show_head()
        self._guarded(self._show_map)
        title = f"Step {step + 1} of {record.layout.steps}, t = {record.time[step]:.3f} s"
        self.controls["step"].update(title=title, value=step)
        self._guarded(self._show_view)
        if PICKED[int(self.picked.active)] == "node":
            self._guarded(lambda: self.node.show_step(self.place))
        else:
            self._show_picked()

    def _show_map(self) -> None:
        record, place = self.session.record, self.place
        self.map.show(place)
        for widget in self.of_scale:
            widget.disabled = place.show == "quality"
        self._setting_limits = True
        self.controls["low"].value, self.controls["high"].value = self.map.limits(place)
        self._setting_limits = False
        self._status_shown = int(record.ledger[place.step])
        shown, status = display(place.show), _STATUS_WORDS.get(FrameStatus(self._status_shown), "")
        what = f"{place.show}: {shown.long_name}{shown.in_unit}"
        self.map.layout.title.text = f"{what}, t = {record.time[place.step]:.3f} s{status}"

    def _show_view(self) -> None:
        """Draw the tab "cameras" or "waves" if it is open; `_show_map` draws the map."""
        if self.place.tab in self._views:
            self._views[self.place.tab]().show(self.place)
            self._show_corners()
        self.link.text = self.place.query()

    def _show_picked(self) -> None:
        """Draw the open tab of the second group: values at the picked node, or masks."""
        if PICKED[int(self.picked.active)] == "node":
            self.node.show(self.place)
        else:
            self.masks()
        self.link.text = self.place.query()

    def _show_masks(self) -> None:
        """Draw the corners that the user clicked, and the masks of the experiment file."""
        from wavefield.series.masks import WATER, footprints

        if self.masks.made:
            self.map.sources["mask"].data = self.masks.made.closed_line(WATER)
            self._show_corners()
        experiment = self.session.run.experiment
        lines = footprints(experiment.mask) if experiment is not None else ()
        xs, ys = ([[corner[k] for corner in line] for line in lines] for k in (0, 1))
        self.map.sources["masks"].data = {"xs": xs, "ys": ys}

    def _show_corners(self) -> None:
        cameras, masks = self.cameras.made, self.masks.made
        if cameras and masks:
            cameras.sources["mask"].data = masks.closed_line(parts.chosen(cameras.camera))

    # -- the head --------------------------------------------------------------------------------------

    def _show_head(self) -> None:
        """Show the number of measured steps, how much of the preview (thinned copy) is loaded, and errors."""
        record, preview = self.session.record, self.session.record.preview
        done, steps = record.steps_done, record.layout.steps
        words = f"{steps} steps at {record.frame_rate:g} Hz, {spell_time(steps / record.frame_rate)}"
        if done < steps:
            words += f"; measured so far: {done} ({100 * done // steps} %)"
        if not preview.complete:
            percent = 100 * preview.count // max(int(preview.measured.sum()), 1)
            words += f"; reading the preview for series: {percent} %"
        for trouble in filter(None, (preview.trouble, self.trouble)):
            words += f"; {parts.plain(trouble)}"
        self.state.text = f"{self._error} {words}".strip()

    def _show_verdict(self) -> None:
        """Show the verdict on the cube's quality, if there is one; a click unfolds the remarks in it."""
        try:
            found = read_verdict(self.session.record.path)
        except WavefieldError as error:
            self.verdict.text = parts.alert(error)
            return
        if found is None:
            self.verdict.text = ""
            return
        count = sum(remark.weight != "note" for remark in found.remarks)
        remarks = [Markup(_CODE.sub(r"<code>\1</code>", parts.plain(remark))) for remark in found.remarks]
        self.verdict.text = parts.template("verdict.html").render(
            colour=_COLOURS[found.weight], words=WORDS[found.weight], count=count, remarks=remarks
        )

    # -- while the cube is being written ---------------------------------------------------------------

    def recheck(self) -> None:
        """Read the status of the steps again and draw what has changed; called every two seconds."""
        record = self.session.record
        if record.steps_done < record.layout.steps and record.refresh():
            self.session.load()
            self._show_verdict()
        # another page of this server may have read the new status first
        if int(record.ledger[self.place.step]) != self._status_shown:
            self.redraw()
        chunks = record.preview.count
        if chunks != self._chunks_shown and (record.preview.complete or not self.place.node):
            self._show_picked()
        self._chunks_shown = chunks
        if self.place.tab == "waves":
            self.waves().show(self.place)
        self._show_head()
