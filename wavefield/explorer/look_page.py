"""The page of `wavefield look`: one session of one reader, thin over the panels."""

from collections.abc import Callable
from dataclasses import replace
from html import escape

from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.layouts import column

from wavefield.errors import WavefieldError
from wavefield.explorer.look_controls import LookControls
from wavefield.explorer.look_panels import LookPanels
from wavefield.explorer.place import TABS, Place, Value
from wavefield.explorer.plot_parts import alert, chosen, words_of
from wavefield.explorer.session import LookSession
from wavefield.explorer.template import apply_template
from wavefield.figures.display import display
from wavefield.series.masks import WATER
from wavefield.text import spell_time
from wavefield.variables import FrameStatus

_RECHECK_MS = 2000  # between checks of the ledger of a cube that is being written
_DRAG_TABS = {"line": "line", "rectangle": "area", "mask": "mask"}
_STATUS_WORDS = {
    FrameStatus.NOT_STARTED: " – not measured yet",
    FrameStatus.FAILED: " – this step could not be measured",
}


class LookPage:
    """One reader's page."""

    def __init__(self, session: LookSession, place: Place) -> None:
        self.session, self.place = session, place
        self.state = words_of("state_words", html=True)
        self.controls = LookControls(session.record, place)
        self.panels = LookPanels(
            session, place, self.controls.drag, self.pick, self._take_corner, self._masks_changed
        )
        self._document: Document | None = None
        self._scheduled: set[str] = set()  # names of drawings that are due
        self._chunks_shown = -1  # of the preview
        self._status_shown = -1  # of the step of the map
        self._setting_limits = False  # by the program
        self._listen()

    def _listen(self) -> None:
        controls, panels = self.controls, self.panels
        controls.variable.on_change(
            "value", lambda a, o, new: self.change(show=chosen(controls.variable), limits=None)
        )
        controls.step.on_change("value", lambda a, o, new: self.change(step=self._within(new)))
        controls.arrows.on_change("active", lambda a, o, new: self.change(arrows=bool(new)))
        controls.drag.on_change("value", lambda a, o, new: self._drag_mode(chosen(controls.drag)))
        controls.low.on_change("value", lambda a, o, new: self._limits_entered())
        controls.high.on_change("value", lambda a, o, new: self._limits_entered())
        controls.fit.on_click(self._fit)
        controls.play_on(panels.map.sources["image"])
        panels.views.on_change("active", lambda a, o, new: self.change(tab=TABS[int(new)]))
        panels.picked.on_change("active", lambda a, o, new: self._soon(self._show_picked))
        for widget in (panels.cameras.camera, panels.cameras.frame, panels.cameras.overlay):
            widget.on_change("value", lambda a, o, new: self._soon(self._show_view))

    def attach(self, document: Document) -> None:
        """Put the page into a document."""
        self._document = document
        state = column(self.state, sizing_mode="stretch_width", name="state")
        for root in (state, self.controls.layout, self.panels.views, self.panels.picked):
            document.add_root(root)
        apply_template(document, self.session.record.experiment, "look", ("controls", "views", "picked"))
        document.on_event(DocumentReady, lambda event: self._soon(self._show_picked))
        document.add_periodic_callback(self.recheck, _RECHECK_MS)
        self._show_state()
        self.panels.show_masks()
        self.redraw()

    # -- actions of the reader -------------------------------------------------------------------------

    def change(self, **changed: Value) -> None:
        """Go to another place."""
        place = replace(self.place, **changed)  # type: ignore[arg-type]  # fields of a place by name
        if place != self.place:
            self.place = place
            self._soon(self._show_view if list(changed) == ["tab"] else self.redraw)

    def _within(self, step: float) -> int:
        return int(min(max(step, 0), self.session.record.layout.steps - 1))

    def pick(self, kind: str, where: tuple[float, ...]) -> None:
        """Show the "node", "line" or "area" that was picked on the map or in an image."""
        if kind == "node" and self._take_corner(WATER, (where[0], where[1])):
            return
        picked: dict[str, Value] = {kind: tuple(where)}
        self.place = replace(self.place, **picked)  # type: ignore[arg-type]
        self.panels.open_picked(kind)
        self.panels.map.mark(self.place)
        self._soon(self._show_picked)
        if self.place.tab == "cameras":
            self._soon(self._show_view)

    def _drag_mode(self, mode: str) -> None:
        self.place = replace(self.place, drag=mode)
        if mode in _DRAG_TABS:
            self.panels.open_picked(_DRAG_TABS[mode])
        self._write_link()

    def _take_corner(self, image: str, corner: tuple[float, float]) -> bool:
        """Take a click as the corner of a mask, if masks are being drawn."""
        if self.place.drag != "mask":
            return False
        self.panels.open_picked("mask")
        self.panels.masks.add(image, corner)
        return True

    def _masks_changed(self) -> None:
        self.panels.show_masks()
        if self.place.tab == "cameras":
            self._soon(self._show_view)

    def _limits_entered(self) -> None:
        limits = self.controls.limits
        if self._setting_limits or limits is None:
            return
        if limits not in (self.place.limits, self.panels.map.fitted(self.place.show)):
            self.change(limits=limits)

    def _fit(self) -> None:
        self.panels.map.forget(self.place.show)
        self.place = replace(self.place, limits=None)
        self._soon(self.redraw)

    # -- drawing ---------------------------------------------------------------------------------------

    def _soon(self, draw: Callable[[], None]) -> None:
        """Draw once, however many changes come together."""
        name = draw.__name__
        if self._document is None or name in self._scheduled:
            return
        self._scheduled.add(name)

        def run() -> None:
            self._scheduled.discard(name)
            self._guarded(draw)

        self._document.add_next_tick_callback(run)

    def _guarded(self, draw: Callable[[], None]) -> None:
        """Draw; an error becomes a sentence, and the page goes on."""
        try:
            draw()
        except WavefieldError as error:
            self.state.text = alert(error)

    def redraw(self) -> None:
        """Show the place anew."""
        step, record = self.place.step, self.session.record
        self._guarded(self._show_map)
        self.controls.step.title = f"Step {step} of {record.layout.steps}, t = {record.time[step]:.3f} s"
        self.controls.step.value = step
        self.panels.node.now.location = float(record.time[step])
        self.panels.show_view(self.place)
        self.panels.show_step(self.place)
        self._write_link()

    def _show_map(self) -> None:
        record, place, panel = self.session.record, self.place, self.panels.map
        panel.show(place)
        panel.mark(place)
        self._setting_limits = True
        self.controls.low.value, self.controls.high.value = self.panels.limits(place)
        self._setting_limits = False
        self._status_shown = int(record.ledger[place.step])
        shown = display(place.show)
        panel.figure.title.text = (
            f"{place.show}: {shown.long_name}{shown.in_unit}, t = {record.time[place.step]:.3f} s"
            + _STATUS_WORDS.get(FrameStatus(self._status_shown), "")
        )

    def _show_view(self) -> None:
        self.panels.show_view(self.place)
        self._write_link()

    def _show_picked(self) -> None:
        self.panels.show_picked(self.place)
        self._write_link()

    def _write_link(self) -> None:
        self.controls.link.text = self.place.query()

    # -- while the cube is being written ---------------------------------------------------------------

    def recheck(self) -> None:
        """Read the ledger again, and show what is new; other pages of the server may have noticed first."""
        record = self.session.record
        if record.steps_done < record.layout.steps and record.refresh():
            self.session.load()
        if record.ledger[self.place.step] != self._status_shown:
            self.redraw()
        chunks = int(record.preview.loaded.sum())
        if chunks != self._chunks_shown and (record.preview.complete or not self.place.node):
            self._show_picked()
        self._chunks_shown = chunks
        if self.place.tab == "waves":
            self.panels.waves().show()
        self._show_state()

    def _show_state(self) -> None:
        """Show how far the run and the reading of its preview are."""
        record, preview = self.session.record, self.session.record.preview
        done, steps = record.steps_done, record.layout.steps
        words = f"{steps} steps at {record.frame_rate:g} Hz, {spell_time(steps / record.frame_rate)}"
        if done < steps:
            words += f"; measured so far: {done} ({100 * done // steps} %)"
        if not preview.complete:
            percent = 100 * int(preview.loaded.sum()) // max(int(preview.measured.sum()), 1)
            words += f"; reading the preview for series: {percent} %"
        for trouble in filter(None, (preview.trouble, self.panels.trouble)):
            words += f"; {escape(trouble, quote=False)}"
        self.state.text = words
