"""The page of `wavefield look`: one session of one person, thin over the panels."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from bokeh.events import DocumentReady
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    CustomJS,
    Div,
    NumericInput,
    Select,
    Slider,
    Toggle,
)

from wavefield.errors import WavefieldError
from wavefield.explorer.area_panel import AreaPanel
from wavefield.explorer.camera_panel import CameraPanel
from wavefield.explorer.context import CubeContext
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.line_panel import LinePanel
from wavefield.explorer.map_fields import shown_as
from wavefield.explorer.map_panel import MapPanel
from wavefield.explorer.mask_panel import MaskPanel
from wavefield.explorer.node_panel import NodePanel
from wavefield.explorer.place import DRAGS, TABS, Place
from wavefield.explorer.plot_parts import Later, make_tabs
from wavefield.explorer.save_panel import SavePanel
from wavefield.explorer.surface_panel import SurfacePanel
from wavefield.explorer.template import dress
from wavefield.explorer.wave_panel import WavePanel
from wavefield.series.masks import WATER, footprints
from wavefield.text import spell_time

_RECHECK_MS = 2000  # ms between looks at the ledger of a cube that is being written

# Plays from the browser: the next step is asked for when this one has arrived, so that nothing piles up.
_PLAY = """
const next = () => {
  if (!play.active) return
  const wait = Math.max(0, 80 - (performance.now() - (play._asked ?? 0)))
  setTimeout(() => {
    if (!play.active) return
    play._asked = performance.now()
    step.value = step.value >= step.end ? step.start : step.value + 1
  }, wait)
}
if (cb_obj === play) { play.label = play.active ? "Pause" : "Play"; next() }
else if (play.active) requestAnimationFrame(next)
"""
_LINK = """
history.replaceState(null, "", location.pathname + "?" + cb_obj.text)
"""


@dataclass(frozen=True)
class LookSession:
    """What all sessions of one server share."""

    record: CubeRecord  # The cube
    beside: CubeContext  # What lies beside it

    def load(self) -> threading.Thread:
        """Read the preview in the background."""
        thread = threading.Thread(target=self.record.preview.load, daemon=True, name="preview")
        thread.start()
        return thread


class Page:
    """One person's page."""

    def __init__(self, session: LookSession, place: Place) -> None:
        self.session, self.place = session, place
        record, beside = session.record, session.beside
        self._record = record
        self._scheduled: set[str] = set()
        self._known = self._tried = -1
        self._fitting = False
        self._make_controls()
        self.map = MapPanel(record, self.drag, self.pick)
        self.surface = Later(lambda: SurfacePanel(record))
        self.cameras = CameraPanel(record, beside, self.pick, self._is_corner)
        depth = float(record.group.attrs.get("water_depth", np.inf))
        self.waves = Later(lambda: WavePanel(beside, depth))
        self.node = NodePanel(record, beside.probes)
        self.line = Later(lambda: LinePanel(record))
        self.area = Later(lambda: AreaPanel(record))
        self.save = SavePanel()
        self.masks = MaskPanel(beside, self._show_masks)
        if beside.probes is not None:
            places = beside.probes.probe_x.values, beside.probes.probe_y.values
            self.map.mark_probes([str(n) for n in beside.probes.probe.values], *places)
        self._make_tabs()
        self._listen()

    # -- making ----------------------------------------------------------------------------------------

    def _make_controls(self) -> None:
        record, place = self._record, self.place
        names = {n: f"{n}: {record.long_name(n)}" for n in record.names}
        self.variable = Select(
            title="Map of", value=place.show, options=list(names.items()), name="show", width=230
        )
        self.step = Slider(
            title="Step", start=0, end=max(record.layout.steps - 1, 1), value=place.step, step=1, name="step",
            sizing_mode="stretch_width", show_value=False, min_width=200,
        )  # fmt: skip
        self.play = Toggle(label="Play", name="play", width=70)
        self.back = Button(label="\u25c0", name="back", width=40)
        self.forward = Button(label="\u25b6", name="forward", width=40)
        self.low = NumericInput(title="Colours from", mode="float", name="low", width=90)
        self.high = NumericInput(title="to", mode="float", name="high", width=90)
        self.fit = Button(label="Fit", name="fit", width=50)
        self.arrows = Toggle(label="Arrows", active=place.arrows, name="arrows", width=80)
        self.drag = Select(title="Dragging", value=place.drag, options=list(DRAGS), name="drag", width=110)
        self.state = Div(text="", name="state_words", sizing_mode="stretch_width")
        self.link = Div(text=place.query(), name="link", visible=False)
        low = {"align": "end"}
        for widget in (self.play, self.back, self.forward, self.fit, self.arrows):
            widget.update(**low)
        self.controls = column(
            row(
                self.variable, self.low, self.high, self.fit, self.arrows, self.drag,
                self.back, self.play, self.forward, sizing_mode="stretch_width", css_classes=["bar"],
                styles={"flex-wrap": "wrap"},
            ),
            self.step,
            self.link,
            name="controls",
            sizing_mode="stretch_width",
        )  # fmt: skip

    def _make_tabs(self) -> None:
        views = (
            ("Map", self.map.figure), ("Surface", self.surface.body), ("Cameras", self.cameras.layout),
            ("Waves", self.waves.body),
        )  # fmt: skip
        self.views = make_tabs("views", TABS.index(self.place.tab), views)
        picked = (
            ("Node", self.node.layout), ("Line", self.line.body), ("Rectangle", self.area.body),
            ("Save", self.save.layout), ("Mask", self.masks.layout),
        )  # fmt: skip
        self.picked = make_tabs("picked", 1 if self.place.line else 2 if self.place.area else 0, picked)

    def _listen(self) -> None:
        self.variable.on_change("value", lambda a, o, new: self.change(show=new, limits=None))
        self.step.on_change("value", lambda a, o, new: self.change(step=int(new)))
        self.arrows.on_change("active", lambda a, o, new: self.change(arrows=bool(new)))
        self.drag.on_change("value", lambda a, o, new: self._dragging(new))
        self.views.on_change("active", lambda a, o, new: self.change(tab=TABS[int(new)]))
        self.picked.on_change("active", lambda a, o, new: self._soon(self._show_picked))
        self.low.on_change("value", lambda a, o, new: self._limits())
        self.high.on_change("value", lambda a, o, new: self._limits())
        self.fit.on_click(self._fit)
        for widget in (self.cameras.camera, self.cameras.frame, self.cameras.drawn):
            widget.on_change("value", lambda a, o, new: self._soon(self._show_view))
        for button, by in ((self.back, -1), (self.forward, 1)):
            code = "step.value = Math.max(step.start, Math.min(step.end, step.value + by))"
            button.js_on_click(CustomJS(args={"step": self.step, "by": by}, code=code))
        play = CustomJS(args={"play": self.play, "step": self.step}, code=_PLAY)
        self.play.js_on_change("active", play)
        self.map.image.js_on_change("data", play)
        self.link.js_on_change("text", CustomJS(code=_LINK))

    def attach(self, document: Any) -> None:
        """Put the page into a document."""
        self._document = document
        self.views.update(name="views")
        for root, name in (
            (column(self.state, sizing_mode="stretch_width"), "state"),
            (self.controls, "controls"),
            (self.views, "views"),
            (self.picked, "picked"),
        ):
            root.name = root.name or name
            document.add_root(root)
        dress(document, f"{self._record.experiment}", "look", ("controls", "views", "picked"))
        document.on_event(DocumentReady, lambda event: self._soon(self._show_picked))
        document.add_periodic_callback(self._recheck, _RECHECK_MS)
        self._fit_words()
        self._show_masks()
        self.redraw()
        if self.place.tab == "waves":
            self.waves().show()

    # -- what people do --------------------------------------------------------------------------------

    def change(self, **what: Any) -> None:
        """Go to another place."""
        new = replace(self.place, **what)
        if new == self.place:
            return
        if "tab" in what and len(what) == 1:
            self.place = new
            self._soon(self._show_view)
        else:
            self.place = new
            self._soon(self.redraw)

    def pick(self, kind: str, where: tuple[float, ...]) -> None:
        """Something was picked on the map or in an image."""
        if kind == "node" and self._is_corner(WATER, (where[0], where[1])):
            return
        found: dict[str, Any] = {kind: tuple(where)}
        self.place = replace(self.place, **found)
        self.picked.active = {"node": 0, "line": 1, "area": 2}[kind]
        self.map.mark(self.place)
        self._soon(self._show_picked)
        if self.place.tab == "cameras":
            self._soon(self._show_view)

    def _dragging(self, kind: str) -> None:
        self.place = replace(self.place, drag=kind)
        self.picked.active = {"line": 1, "rectangle": 2, "mask": 4}.get(kind, self.picked.active)
        self._write_link()

    def _is_corner(self, where: str, corner: tuple[float, float]) -> bool:
        """Take a click as the corner of a mask, if masks are being drawn."""
        if self.place.drag != "mask":
            return False
        self.picked.active = 4
        self.masks.add(where, corner)
        return True

    def _limits(self) -> None:
        low, high = self.low.value, self.high.value
        if self._fitting:
            return
        if low is not None and high is not None and low < high:
            limits = (float(low), float(high))
            if limits != self.place.limits and limits != self.map.fitting(self.place.show):
                self.change(limits=limits)

    def _fit(self) -> None:
        self.map.forget(self.place.show)
        self.place = replace(self.place, limits=None)
        self._soon(self.redraw)

    # -- drawing ---------------------------------------------------------------------------------------

    def _soon(self, draw: Callable[[], None]) -> None:
        """Draw once, however many changes come together."""
        name = draw.__name__
        if name in self._scheduled:
            return
        self._scheduled.add(name)

        def run() -> None:
            self._scheduled.discard(name)
            self._guarded(draw)

        self._document.add_next_tick_callback(run)

    def _guarded(self, draw: Callable[[], None]) -> None:
        """What goes wrong in one drawing is a sentence; the page goes on."""
        try:
            draw()
        except WavefieldError as error:
            self.state.text = f'<span role="alert">{_plain(str(error))}</span>'

    def redraw(self) -> None:
        """Show the place anew."""
        place = self.place
        self._guarded(self._show_map)
        self.step.title = (
            f"Step {place.step} of {self._record.layout.steps}, t = {self._record.time[place.step]:.3f} s"
        )
        if self.step.value != place.step:
            self.step.value = place.step
        self.node.now.location = float(self._record.time[place.step])
        self._show_view(maps=False)
        self._show_picked(step_only=True)

    def _show_map(self) -> None:
        self.map.show(self.place)
        self.map.mark(self.place)
        low, high = self.limits
        self._fitting = True  # what is set here is nobody's wish
        self.low.value, self.high.value = low, high
        self._fitting = False
        time = self._record.time[self.place.step]
        tried = self._tried = int(self._record.ledger[self.place.step])
        words = {0: "not measured yet", 3: "this step could not be measured"}.get(int(tried), "")
        name, record = self.place.show, self._record
        self.map.figure.title.text = (
            f"{name}: {record.long_name(name)}{shown_as(name, record.units(name)).suffix}, t = {time:.3f} s"
            + (f" \u2013 {words}" if words else "")
        )

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of the colour scale, in the shown unit."""
        return self.place.limits or self.map.fitting("w" if self.place.show == "quality" else self.place.show)

    def _show_view(self, maps: bool = True) -> None:
        if self.place.tab == "surface":
            self.surface().show(self.place, self.limits)
        elif self.place.tab == "cameras":
            self.cameras.show(self.place)
            x, y = self.masks.closed(self.cameras.camera.value)
            self.cameras.mask.data = {"x": x, "y": y}
        elif self.place.tab == "waves" and maps:
            self.waves().show()
        self._write_link()

    def _show_picked(self, step_only: bool = False) -> None:
        active = int(self.picked.active)
        if active == 0:
            (self.node.step if step_only else self.node.show)(self.place)
        elif active == 1:
            self.line().show(self.place, self.limits)
        elif active == 2:
            self.area().show(self.place)
        elif active == 3:
            self.save.show(self.place, self._record)
        self._write_link()

    def _show_masks(self) -> None:
        """Draw corners and the masks of the experiment file."""
        x, y = self.masks.closed(WATER)
        self.map.mask.data = {"x": x, "y": y}
        x, y = self.masks.closed(self.cameras.camera.value)
        self.cameras.mask.data = {"x": x, "y": y}
        experiment = self.session.beside.experiment
        lines = footprints(experiment.mask) if experiment else ()
        xs, ys = ([[corner[k] for corner in line] for line in lines] for k in (0, 1))
        self.map.masks.data = {"xs": xs, "ys": ys}
        if self.place.tab == "cameras":
            self._soon(self._show_view)

    def _write_link(self) -> None:
        self.link.text = self.place.query()

    # -- while it is being written ---------------------------------------------------------------------

    def _recheck(self) -> None:
        """Look at the ledger, read what is new; says how far the run and the preview are."""
        record = self._record
        if record.steps_done < record.layout.steps and record.refresh():
            self.session.load()
        if record.ledger[self.place.step] != self._tried:  # whoever noticed first
            self.redraw()
        known = int(record.preview.known.sum())
        if known != self._known and (record.preview.complete or not self.place.node):
            self._show_picked()
        self._known = known
        if self.place.tab == "waves":
            self.waves().show()
        self._fit_words()

    def _fit_words(self) -> None:
        record = self._record
        done, steps = record.steps_done, record.layout.steps
        words = f"{steps} steps at {record.frame_rate:g} Hz, {spell_time(steps / record.frame_rate)}"
        if done < steps:
            words += f"; measured so far: {done} ({100 * done // steps} %)"
        if not record.preview.complete:
            known, requested = record.preview.known.sum(), record.preview.requested.sum()
            words += f"; reading the preview for series: {100 * int(known) // max(int(requested), 1)} %"
        if record.preview.trouble:
            words += f"; {_plain(record.preview.trouble)}"
        self.state.text = words


def _plain(words: str) -> str:
    """Text that cannot be taken for markup."""
    return words.replace("&", "&amp;").replace("<", "&lt;")
