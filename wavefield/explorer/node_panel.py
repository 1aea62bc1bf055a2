"""A node's time series with its uncertainty and quality, and its spectrum beside a near probe's."""

import threading
import time
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, Div, LinearColorMapper, Select, Span
from numpy.typing import NDArray

from wavefield.errors import StoreError
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.derived_series import derived_series
from wavefield.explorer.map_fields import DERIVED, readings, shown_as
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import (
    BLUE,
    INK,
    MOST_POINTS,
    VERMILION,
    band,
    envelope,
    make_figure,
    number,
)
from wavefield.explorer.selections import nearest, spectrum
from wavefield.figures.quality import KINDS, quality_kind

_MAIN = ("z", "u", "v", "w")
_REDRAW_SECONDS = 0.5  # s
_NEAR = 0.25  # m: a probe farther away sees other waves


class Asked(NamedTuple):
    """A node whose derived series somebody wants to see."""

    j: int
    i: int
    steps: int  # that the cube had then


class NodePanel:
    """What is known at one node."""

    def __init__(self, record: CubeRecord, probes: xr.Dataset | None = None) -> None:
        self._record, self._probes = record, probes
        self._main = tuple(name for name in _MAIN if name in record.stored)
        others = [n for n in record.names if n not in (*_MAIN, "quality") and not n.endswith("_std")]
        self.words = Div(text="Click a node of the map.", name="node_words", sizing_mode="stretch_width")
        self.other = Select(
            title="Below", value=others[0] if others else "", options=others, name="node_other"
        )
        self.which = Select(title="Spectrum of", value="z", options=list(self._main), name="node_which")
        # one source a figure: what arrives together is painted once, and all of it must fit a browser's
        # buffer of 128 kB or half of it is painted first
        self.series = {
            name: ColumnDataSource({"t": [], "value": [], "low": [], "high": []}, name=f"node_{name}_series")
            for name in self._main
        }
        self.series["other"] = ColumnDataSource({"t": [], "value": []}, name="node_other_series")
        self.now = Span(dimension="height", location=0, line_color=INK, line_dash="dotted")
        self.figures: list[Any] = []
        for name in (*self._main, "other"):
            self.figures.append(self._draw(name))
        self.kinds = ColumnDataSource({"left": [], "right": [], "kind": []}, name="node_quality")
        self.strip = self._draw_strip()
        self.density = ColumnDataSource({"f": [], "e": [], "low": [], "high": []}, name="node_spectrum")
        self.probe = ColumnDataSource({"f": [], "e": []}, name="node_probe_spectrum")
        self.spectrum = self._draw_spectrum()
        self._at: tuple[int, int] | None = None  # in the preview
        self._node = 0, 0  # in the cube
        self._asked: Asked | None = None
        self._found: tuple[Asked, dict[str, NDArray[Any]]] | None = None
        self._reading = False
        self.other.on_change("value", lambda attr, old, new: self._show_other())
        self.which.on_change("value", lambda attr, old, new: self._show_spectrum())
        self.figures[0].x_range.on_change("start", self._zoomed)
        self._pending = False
        self.layout = column(
            self.words,
            *self.figures,
            self.strip,
            row(self.which, self.other),
            self.spectrum,
            sizing_mode="stretch_width",
        )

    def _draw(self, name: str) -> Any:
        time = self._record.time
        share = {"x_range": self.figures[0].x_range} if self.figures else {"x_range": (time[0], time[-1])}
        made = make_figure(f"node_{name}_figure", height=96, y_axis_label=self._label(name), **share)
        made.xaxis.visible = False
        source = self.series[name]
        if "low" in source.column_names:
            made.varea("t", "low", "high", source=source, fill_color=BLUE, fill_alpha=0.22)
        made.line("t", "value", source=source, color=BLUE, line_width=1.1)
        made.add_layout(self.now)
        return made

    def _label(self, name: str) -> str:
        name = self.other.value if name == "other" else name
        return f"{name}{shown_as(name, self._record.units(name)).suffix}" if name else ""

    def _draw_strip(self) -> Any:
        made = make_figure(
            "node_strip",
            height=66,
            x_range=self.figures[0].x_range,
            y_range=(0, 1),
            x_axis_label="t (s); strip: quality",
        )
        mapper = LinearColorMapper(palette=[k[2] for k in KINDS], low=-0.5, high=len(KINDS) - 0.5)
        colour = {"field": "kind", "transform": mapper}
        made.quad("left", "right", 0, 1, source=self.kinds, fill_color=colour, line_color=None)
        made.yaxis.ticker = []
        made.yaxis.axis_label = ""
        made.ygrid.visible = False
        return made

    def _draw_spectrum(self) -> Any:
        made = make_figure(
            "node_spectrum_figure", height=190, x_axis_type="log", y_axis_type="log",
            x_axis_label="frequency (Hz)", tools="pan,wheel_zoom,reset",
        )  # fmt: skip
        made.varea("f", "low", "high", source=self.density, fill_color=BLUE, fill_alpha=0.22)
        made.line("f", "e", source=self.density, color=BLUE, line_width=1.6, legend_label="this node")
        made.line(
            "f",
            "e",
            source=self.probe,
            color=VERMILION,
            line_width=1.6,
            line_dash="dashed",
            legend_label="probe",
        )
        made.legend.label_text_font_size = "11px"
        made.legend.background_fill_alpha = 0.7
        made.legend.padding = 4
        return made

    # -- showing ---------------------------------------------------------------------------------------

    def show(self, place: Place) -> None:
        """Show the node of a place."""
        preview = self._record.preview
        self.step(place)
        if place.node is None:
            return
        self._at = nearest(preview.y, place.node[1]), nearest(preview.x, place.node[0])
        self._node = nearest(self._record.y, place.node[1]), nearest(self._record.x, place.node[0])
        for name in self._main:
            self._show_series(name)
        self._show_other()
        self._show_quality()
        self._show_spectrum()

    def step(self, place: Place) -> None:
        """Show the values at the node at another step."""
        record = self._record
        self.now.location = float(record.time[place.step])
        if place.node is None:
            return
        j, i = nearest(record.y, place.node[1]), nearest(record.x, place.node[0])
        values = {name: float(record.field(name, place.step)[j, i]) for name in record.stored}
        units = {name: record.units(name) for name in record.stored}
        first = ", ".join(_with_std(name, values, units) for name in self._main)
        rest = [n for n in record.stored if n not in (*self._main, "quality") and not n.endswith("_std")]
        kind = quality_kind(np.array([int(values.get("quality", 0))]))[0]
        word = KINDS[kind][1] if kind < len(KINDS) else "nothing measured"
        every = record.preview.thin.every
        series = f" Series: the nearest of every {_ordinal(every)} node." if every > 1 else ""
        self.words.text = (
            f"<b>x {number(record.x[i], 4)} m, y {number(record.y[j], 4)} m, "
            f"t {record.time[place.step]:.3f} s:</b> {first}; "
            f"{readings(values, units, rest)}; {word}.{series}"
        )

    def _series(self, name: str) -> NDArray[Any]:
        assert self._at is not None
        factor = shown_as(name, self._record.units(name)).factor
        return self._record.preview.series(name, *self._at) * np.float32(factor)

    def _window(self) -> slice:
        """Steps in view: all of them until somebody zooms."""
        time, view = self._record.time, self.figures[0].x_range
        first = int(np.searchsorted(time, view.start or time[0]))
        last = int(np.searchsorted(time, view.end or time[-1], side="right"))
        return slice(max(first - 1, 0), max(last + 1, first + 2))

    def _show_series(self, name: str) -> None:
        part = self._window()
        time, values = self._record.time[part], self._series(name)[part]
        std = np.full_like(values, np.nan)
        if f"{name}_std" in self._record.stored:
            scale = shown_as(name, self._record.units(name)).factor
            std = self._record.preview.series(f"{name}_std", *self._at)[part] * np.float32(scale)  # type: ignore[misc]
        t, value, std = envelope(time, values, std)
        low, high = band(value, std, thinned=t.size < time.size)
        self.series[name].data = {"t": t, "value": value, "low": low, "high": high}

    def _show_other(self) -> None:
        name = self.other.value
        if self._at is None or not name:
            return
        self.figures[-1].yaxis.axis_label = self._label("other")
        part = self._window()
        series = self._derived(name) if name in DERIVED else self._series(name)
        thin_t, thin = envelope(self._record.time[part], series[part])
        self.series["other"].data = {"t": thin_t, "value": thin}

    def _derived(self, name: str) -> NDArray[Any]:
        """A derived series; empty until it is read, which a thread of its own does."""
        asked = Asked(*self._node, self._record.steps_done)
        if self._found is not None and self._found[0] == asked:
            series = self._found[1].get(name)
            if series is not None:
                return series * np.float32(shown_as(name, self._record.units(name)).factor)
            return np.full(self._record.time.size, np.nan, np.float32)
        self._asked = asked
        document = self.layout.document
        if not self._reading and document is not None:
            self._reading = True
            threading.Thread(target=self._read, args=(document,), daemon=True, name="derived").start()
        return np.full(self._record.time.size, np.nan, np.float32)

    def _read(self, document: Any) -> None:
        """Read what was asked for last, and again if that has changed meanwhile."""
        last_redraw = time.monotonic()

        def progress(done: float) -> None:
            nonlocal last_redraw
            if time.monotonic() - last_redraw > _REDRAW_SECONDS:
                last_redraw = time.monotonic()
                document.add_next_tick_callback(lambda: self._report(f"reading: {100 * done:.0f} %"))

        while self._asked is not None and (self._found is None or self._found[0] != self._asked):
            asked = self._asked
            try:
                self._found = asked, derived_series(self._record, asked.j, asked.i, progress)
            except StoreError as error:
                document.add_next_tick_callback(partial(setattr, self.words, "text", str(error)))
                self._found = asked, {}
        self._reading = False
        document.add_next_tick_callback(self._show_other)

    def _report(self, words: str) -> None:
        if self._reading:
            self.figures[-1].yaxis.axis_label = words

    def _show_quality(self) -> None:
        if "quality" not in self._record.stored or self._at is None:
            return
        record = self._record
        raw = record.preview.stored("quality")[self._at]
        kinds = quality_kind(np.where(raw < 0, 0, raw))
        starts = np.flatnonzero(np.r_[True, np.diff(kinds.astype(int)) != 0])
        ends = np.r_[starts[1:], kinds.size]
        shown = kinds[starts] < len(KINDS)
        half = 0.5 / record.frame_rate
        self.kinds.data = {
            "left": record.time[starts[shown]] - half,
            "right": record.time[ends[shown] - 1] + half,
            "kind": kinds[starts[shown]].astype(np.float32),
        }

    def _zoomed(self, attr: str, old: Any, new: Any) -> None:
        """Fetch finer series for a narrower view, once per burst of wheel turns."""
        if self._at is not None and self._record.time.size > MOST_POINTS and not self._pending:
            document = self.layout.document
            if document is not None:
                self._pending = True
                document.add_timeout_callback(self._refine, 120)

    def _refine(self) -> None:
        self._pending = False
        for name in self._main:
            self._show_series(name)
        self._show_other()

    def _show_spectrum(self) -> None:
        if self._at is None:
            return
        name = self.which.value
        shown = shown_as(name, self._record.units(name))
        found = spectrum(self._series(name), 1.0 / self._record.frame_rate)
        self.spectrum.yaxis.axis_label = f"E ({shown.unit})\u00b2/Hz"
        if found is None:
            self.density.data = {"f": [], "e": [], "low": [], "high": []}
            self.spectrum.title.text = "too short a record without gaps for a spectrum"
        else:
            e = found.density
            self.density.data = {"f": found.frequency, "e": e, "low": e * found.low, "high": e * found.high}
            self.spectrum.title.text = f"95 %: factor {number(found.low, 2)} to {number(found.high, 2)}"
        lasting = None if found is None else float(1 / found.frequency[0])  # of a segment, s
        self._show_probe(shown.factor if name == "z" else 0.0, lasting)

    def _show_probe(self, factor: float, lasting: float | None) -> None:
        self.probe.data = {"f": [], "e": []}
        self.spectrum.legend.visible = False
        found = self.near_probe() if factor else None
        if found is None or self._probes is None:
            return
        index, distance = found
        time = self._probes.time.values
        inside = (time >= self._record.time[0]) & (time <= self._record.time[-1])
        values = self._probes.elevation.isel(probe=index).values[inside] * factor
        density = spectrum(values, float(np.mean(np.diff(time))), lasting)
        if density is not None:
            keep = density.frequency <= self._record.frame_rate / 2
            self.probe.data = {"f": density.frequency[keep], "e": density.density[keep]}
            name = str(self._probes.probe.values[index])
            self.spectrum.legend.visible = True
            self.spectrum.title.text += f"; dashed: {name}, {100 * distance:.0f} cm away"

    def near_probe(self) -> tuple[int, float] | None:
        """The nearest probe and its distance in metres; None if none is near."""
        if self._probes is None or self._at is None:
            return None
        x, y = self._record.preview.x[self._at[1]], self._record.preview.y[self._at[0]]
        distance = np.hypot(self._probes.probe_x.values - x, self._probes.probe_y.values - y)
        index = int(np.argmin(np.nan_to_num(distance, nan=np.inf)))
        return (index, float(distance[index])) if distance[index] <= _NEAR else None


def _with_std(name: str, values: dict[str, float], units: dict[str, str]) -> str:
    words = readings(values, units, [name])
    std = values.get(f"{name}_std", float("nan"))
    if not np.isfinite(std) or not np.isfinite(values[name]):
        return words
    shown = shown_as(name, units[name])
    return words.replace(f" {shown.unit}", f" \u00b1 {number(std * shown.factor, 2)} {shown.unit}")


def _ordinal(count: int) -> str:
    return {2: "second", 3: "third"}.get(count, f"{count}th")
