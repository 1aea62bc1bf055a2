"""The page of `wavefield look`: one session of one reader, thin over the panels."""

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
from bokeh.document import Document
from bokeh.events import DocumentReady
from numpy.typing import NDArray

from wavefield.errors import StoreError, WavefieldError
from wavefield.explorer.background_reader import BackgroundReader
from wavefield.explorer.look_controls import LookControls
from wavefield.explorer.look_header import LookHeader
from wavefield.explorer.look_panels import LookPanels
from wavefield.explorer.place import AVERAGES, TABS, Place, Value
from wavefield.explorer.plot_parts import PanelEvents, clear
from wavefield.explorer.session import LookSession
from wavefield.explorer.template import apply_template
from wavefield.explorer.whole_record import AverageRequest, Field, averages, index_of, phases_of, request_of
from wavefield.figures.display import display
from wavefield.variables import FrameStatus

_RECHECK_MS = 2000  # between checks of the ledger of a cube that is being written
_DRAG_TABS = {"line": "line", "rectangle": "area", "mask": "mask"}
_STATUS_WORDS = {
    FrameStatus.NOT_STARTED: " – not measured yet",
    FrameStatus.FAILED: " – this step could not be measured",
    FrameStatus.DISCONTINUOUS: " – this step does not continue its neighbours, and opened cubes leave it out",
}


class LookPage:
    """One reader's page."""

    def __init__(self, session: LookSession, place: Place) -> None:
        self.session, self.place = session, place
        self.header = LookHeader(session)
        self.controls = LookControls(session.record, place)
        events = PanelEvents(
            self.pick, self._take_corner, self._masks_changed, lambda: self._soon(self._show_view)
        )
        self.panels = LookPanels(session, place, self.controls["drag"], events)
        self.averages: BackgroundReader[AverageRequest, dict[str, list[Field]]] = BackgroundReader(
            partial(averages, session.record),
            on_progress=lambda words: self.panels.map.figure.title.update(text=words),
            on_error=lambda words: self.header.report(StoreError(words)),
            on_end=lambda: self._soon(self.redraw),
        )
        self._document: Document | None = None
        self._scheduled: set[str] = set()  # names of drawings that are due
        self._chunks_shown = -1  # of the preview
        self._status_shown = -1  # of the step of the map
        self._setting_limits = False  # by the program
        self._listen()

    def _listen(self) -> None:
        controls, panels = self.controls, self.panels
        for name in ("show", "average", "period", "step", "colours", "log", "overlay"):
            event = "active" if name == "log" else "value"
            controls[name].on_change(event, lambda a, o, new, name=name: self._entered(name))
        controls["drag"].on_change("value", lambda a, o, new: self._drag_mode())
        for name in ("low", "high"):
            controls[name].on_change("value", lambda a, o, new: self._limits_entered())
        controls["fit"].on_click(self._fit)
        controls.play_on(panels.map.sources["image"])
        panels.views.on_change("active", lambda a, o, new: self.change(tab=TABS[int(new)]))
        panels.picked.on_change("active", lambda a, o, new: self._soon(self._show_picked))

    def attach(self, document: Document) -> None:
        """Put the page into a document."""
        self._document = document
        parts = self.controls.layout, self.controls.options, self.panels.views, self.panels.picked
        for root in (self.header.layout, *parts):
            document.add_root(root)
        names = [str(part.name) for part in parts]
        aspect = float(self.panels.map.figure.aspect_ratio)
        apply_template(document, self.session.record.experiment, "look", names, aspect=aspect)
        document.add_periodic_callback(self.recheck, _RECHECK_MS)
        self.header.show()
        self.redraw()
        if document.session_context is None:  # no browser will report that it is ready
            self._show_context()
        else:
            document.on_event(DocumentReady, lambda event: self._ready())

    def _ready(self) -> None:
        """Show what is picked, then what belongs to the cube: that takes a second to import."""
        self._soon(self._show_picked)
        if self.place.tab == "surface":  # which the browser projects when it changes
            self._soon(self._show_view)

        def read() -> None:
            with suppress(WavefieldError):  # shown by `_show_context`
                self.session.run.probes  # noqa: B018
            if self._document is not None:
                self._document.add_next_tick_callback(self._show_context)

        threading.Thread(target=read, daemon=True, name="context").start()

    def _show_context(self) -> None:
        """Show the probes, masks and verdict that belong to the cube; a trouble with one is a sentence."""
        run = self.session.run
        try:
            if run.probes is not None:
                self.panels.show_probes(run.probes)
            elif run.experiment is not None and run.experiment.probes is not None:
                self.header.trouble = run.reason("probes")
        except WavefieldError as error:
            self.header.trouble = f"no probes: {error}"
        self._guarded(self.panels.show_masks)
        self.header.show_verdict()
        self.header.show()
        self._soon(self._show_picked)

    # -- actions of the reader -------------------------------------------------------------------------

    def change(self, **changed: Value) -> None:
        """Go to another place."""
        place = replace(self.place, **changed)  # type: ignore[arg-type]  # fields of a place by name
        if place != self.place:
            self.place = place
            self._soon(self._show_view if list(changed) == ["tab"] else self.redraw)

    def _entered(self, name: str) -> None:
        changed = {name: self.controls.entered(name)}
        if name in ("show", "average", "period", "log"):  # other limits fit
            changed["limits"] = None
        self.change(**changed)

    def pick(self, kind: str, where: tuple[float, ...]) -> None:
        """Show the "node", "line" or "area" that was picked on the map or in an image."""
        if kind == "node":
            from wavefield.series.masks import WATER

            if self._take_corner(WATER, (where[0], where[1])):
                return
        picked: dict[str, Value] = {kind: tuple(where)}
        self.place = replace(self.place, **picked)  # type: ignore[arg-type]
        self.panels.open_picked(kind)
        self.panels.map.mark(self.place)
        self._soon(self._show_picked)
        if self.place.tab == "cameras":
            self._soon(self._show_view)

    def _drag_mode(self) -> None:
        mode = str(self.controls.entered("drag"))
        if mode in _DRAG_TABS:
            self.panels.open_picked(_DRAG_TABS[mode])

    def _take_corner(self, image: str, corner: tuple[float, float]) -> bool:
        """Take a click as the corner of a mask, if masks are being drawn."""
        if self.controls.entered("drag") != "mask":
            return False
        self.panels.open_picked("mask")
        self.panels.masks().add(image, corner)
        return True

    def _masks_changed(self) -> None:
        self.panels.show_masks()
        if self.place.tab == "cameras":
            self._soon(self._show_view)

    def _limits_entered(self) -> None:
        limits = self.controls.limits
        if self._setting_limits or limits is None:
            return
        if limits not in (self.place.limits, self.panels.map.fitted(self.place)):
            self.change(limits=limits)

    def _fit(self) -> None:
        self.panels.map.forget(self.place)
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
            self.header.report(error)

    def redraw(self) -> None:
        """Show the place anew."""
        step, record = self.place.step, self.session.record
        self.header.forget_error()
        self._guarded(self._show_map)
        title = f"Step {step} of {record.layout.steps}, t = {record.time[step]:.3f} s"
        self.controls["step"].update(title=title, value=step)
        self.panels.show_view(self.place)
        self.panels.show_step(self.place)
        self._write_link()

    def _fields(self) -> dict[str, NDArray[np.float32]] | None:
        """What the map shows of the displayed variable and of u and v, (ny, nx); None while it is read."""
        record, place = self.session.record, self.place
        request = request_of(record, place)
        if not place.averaged:
            return {name: record.field(name, place.step) for name in request.names}
        index = index_of(record, place)
        found = None if index is None else self.averages.get(request, self._document)
        return {name: each[index] for name, each in found.items()} if found and index is not None else None

    def _show_map(self) -> None:
        record, place, panel = self.session.record, self.place, self.panels.map
        self.controls["period"].visible = place.average == "phase"
        fields = self._fields()
        if fields is None:
            words = "reading all steps"
            if index_of(record, place) is None:
                words = f"enter the period of the waves, more than {2 / record.frame_rate:.3g} s"
            panel.figure.title.text = f"{place.show}: {words}"
            clear(panel.sources["image"], panel.sources["arrows"])
            return
        panel.show(place, fields)
        panel.mark(place)
        for widget in self.controls.of_scale:
            widget.disabled = place.show == "quality"
        self._setting_limits = True
        self.controls["low"].value, self.controls["high"].value = self.panels.limits(place)
        self._setting_limits = False
        self._status_shown = self._status()
        shown = display(place.show)
        what = f"{place.show}: {shown.long_name}{shown.in_unit}"
        if place.averaged:
            words = f"{what}, {AVERAGES[place.averaged]}"
            index = index_of(record, place)
            if place.averaged == "phase" and place.period and index is not None:
                degrees = 360 * index / phases_of(place.period, record.frame_rate)
                words += f" over {place.period:g} s, phase {degrees:.0f}°"
        else:
            status = _STATUS_WORDS.get(FrameStatus(self._status_shown), "")
            words = f"{what}, t = {record.time[place.step]:.3f} s{status}"
        panel.figure.title.text = words

    def _status(self) -> int:
        return int(self.session.record.ledger[self.place.step])

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
        if record.steps_done < record.layout.steps:
            changed = record.refresh()
            if changed:
                self.session.load()
                self.header.show_verdict()
        if self._status() != self._status_shown:
            self.redraw()
        chunks = record.preview.count
        if chunks != self._chunks_shown and (record.preview.complete or not self.place.node):
            self._show_picked()
        self._chunks_shown = chunks
        if self.place.tab == "waves":
            self.panels.waves().show(self.place)
        self.header.show()
