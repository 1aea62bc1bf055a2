"""Time series at a node with their uncertainty and quality, and its spectrum."""

from html import escape
from typing import TYPE_CHECKING

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import Select, Span
from bokeh.plotting import figure
from numpy.typing import NDArray

from wavefield.explorer import plot_parts as parts
from wavefield.explorer.background_reader import BackgroundReader
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.node_spectrum import NearProbe, NodeSpectrum, nearest_probe
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import number
from wavefield.explorer.selections import nearest
from wavefield.explorer.whole_record import derived_series
from wavefield.figures.display import DERIVED, display
from wavefield.figures.quality_kinds import KINDS, quality_kind

if TYPE_CHECKING:
    import xarray as xr

_MAIN = ("z", "u", "v", "w")
_SERIES_PX = 84  # height of a series
_ZOOM_DELAY_MS = 120  # one refinement per burst of wheel turns


class NodePanel:
    """The values of the cube at one node."""

    def __init__(self, record: CubeRecord) -> None:
        self._record = record
        self.probes: xr.Dataset | None = None  # of the experiment, when they are read
        self._node: tuple[float, float] | None = None  # the picked one, m
        self._refining = False
        self.words = parts.words_of("node_words", "Click a node of the map.", html=True)
        names = self._others(record.names)
        self.other = Select(
            title="Fifth series", value=names[0] if names else "", options=names, name="node_other"
        )
        # One source per figure: what arrives together is painted once, and all of it must fit a browser's
        # buffer of 128 kB, or half of it is painted first.
        series = {f"{name}_series": "t value low high" for name in self._main}
        others = {"other_series": "t value", "quality": "left right kind", "probe_series": "t value"}
        self.sources = parts.make_sources("node", **series, **others)
        self.now = Span(dimension="height", location=0, line_color=parts.INK, line_dash="dotted")
        self.figures: dict[str, figure] = {}
        for name in (*self._main, "other"):
            self.figures[name] = self._draw_series(name)
        self.spectrum = NodeSpectrum(self._main, record.frame_rate)
        # of row, column, and the steps that were done at the time of the request
        self._reader: BackgroundReader[tuple[int, int, int], dict[str, NDArray[np.float32]]]
        self._reader = BackgroundReader(
            lambda request, progress: derived_series(record, *request[:2], progress),
            on_progress=lambda words: self.figures["other"].yaxis.update(axis_label=words),
            on_error=lambda words: self.words.update(text=escape(words, quote=False)),
            on_end=self._show_other,
        )
        self.other.on_change("value", lambda attr, old, new: self._show_other())
        self.spectrum.variable.on_change("value", lambda attr, old, new: self._show_spectrum())
        self.layout = column(
            self.words, *self.figures.values(), self._draw_strip(), row(self.other, self.spectrum.variable),
            self.spectrum.figure, sizing_mode="stretch_width",
        )  # fmt: skip

    @property
    def _main(self) -> tuple[str, ...]:
        return tuple(name for name in _MAIN if name in self._record.stored)

    def _others(self, names: tuple[str, ...]) -> list[str]:
        return [n for n in names if n not in (*self._main, "quality") and not n.endswith("_std")]

    def _draw_series(self, name: str) -> figure:
        time = self._record.time
        x_range = next(iter(self.figures.values())).x_range if self.figures else (time[0], time[-1])
        shown = parts.chosen(self.other) if name == "other" else name
        settings = {"y_axis_label": display(shown).label if shown else "", "x_range": x_range}
        made = parts.make_figure(f"node_{name}_figure", height=_SERIES_PX, **settings)
        if not self.figures:
            made.x_range.on_change("start", lambda attr, old, new: self._zoomed())
        made.xaxis.visible = False
        source = self.sources[f"{name}_series"]
        if name == "other":
            made.line("t", "value", source=source, color=parts.BLUE, line_width=1.1)
            parts.add_hover(made, mode="vline")
        else:
            parts.draw_band(made, source, "t", "value", line_width=1.1)
            rows = ("t", "@t{0.000} s"), (name, f"@value{{0.[000]}} {display(name).unit}")
            parts.add_hover(made, *rows, renderers=made.renderers[1:2], mode="vline")
        if name == "z":
            made.line(
                "t", "value", source=self.sources["probe_series"], color=parts.VERMILION, line_width=1.3,
                line_dash="dashed",
            )  # fmt: skip
        made.add_layout(self.now)
        return made

    def _draw_strip(self) -> figure:
        made = parts.make_figure(
            "node_strip", height=66, x_range=self.figures["other"].x_range, y_range=(0, 1),
            x_axis_label="t (s); strip: quality",
        )  # fmt: skip
        colour = {"field": "kind", "transform": parts.quality_mapper()}
        made.quad("left", "right", 0, 1, source=self.sources["quality"], fill_color=colour, line_color=None)
        made.yaxis.update(ticker=[], axis_label="")
        made.ygrid.visible = False
        return made

    # -- showing ---------------------------------------------------------------------------------------

    def show(self, place: Place) -> None:
        """Show the node of a place."""
        self.show_step(place)
        if self._node is not None:
            self._show_series()
            self._show_quality()
            self._show_spectrum()

    def show_step(self, place: Place) -> None:
        """Show the values at the node at another step."""
        record, self._node = self._record, place.node
        self.now.location = float(record.time[place.step])
        if self._node is None:
            return
        j, i = self._index(record.y, record.x)
        values = {name: float(record.field(name, place.step)[j, i]) for name in record.stored}
        kind = quality_kind(np.array([int(values.get("quality", 0))]))[0]
        every, near = record.preview.thin.every, self._near()
        self.words.text = (
            f"<b>x {number(record.x[i], 4)} m, y {number(record.y[j], 4)} m, "
            f"t {record.time[place.step]:.3f} s:</b> "
            f"{', '.join(_reading(name, values) for name in self._main)}; "
            f"{', '.join(_reading(name, values) for name in self._others(record.stored))}; "
            f"{KINDS[kind][1] if kind < len(KINDS) else 'nothing measured'}."
            + (f" Series: nearest node of the preview (every {_ordinal(every)})." if every > 1 else "")
            + (f" Dashed: {escape(near.words, quote=False)}." if near is not None else "")
        )

    def _index(self, y: NDArray[np.floating], x: NDArray[np.floating]) -> tuple[int, int]:
        """Row and column of the picked node on a grid."""
        assert self._node is not None
        return nearest(y, self._node[1]), nearest(x, self._node[0])

    def _near(self) -> NearProbe | None:
        """The probe nearest to the picked node of the cube, not to that of the thinner preview."""
        if self._node is None:
            return None
        j, i = self._index(self._record.y, self._record.x)
        return nearest_probe(self.probes, self._record.x[i], self._record.y[j])

    def _series(self, name: str, factor: float) -> NDArray[np.floating]:
        """A stored variable at the nearest node of the preview, (time,), times a factor."""
        preview = self._record.preview
        return preview.series(name, *self._index(preview.y, preview.x)) * np.float32(factor)

    def _window(self) -> slice:
        """Steps in view: all of them before anyone zooms."""
        time, view = self._record.time, self.figures["other"].x_range
        first = int(np.searchsorted(time, view.start or time[0]))
        last = int(np.searchsorted(time, view.end or time[-1], side="right"))
        return slice(max(first - 1, 0), max(last + 1, first + 2))

    def _show_series(self) -> None:
        part = self._window()
        time = self._record.time[part]
        for name in self._main:
            factor = display(name).factor
            series = self._series(name, factor)
            values = series[part]
            std = np.full_like(values, np.nan)
            if f"{name}_std" in self._record.stored:
                std = self._series(f"{name}_std", factor)[part]
            t, value, std = parts.envelope(time, values, std)
            low, high = parts.band(value, std, thinned=t.size < time.size)
            self.sources[f"{name}_series"].data = {"t": t, "value": value, "low": low, "high": high}
        self._show_probe(part)
        self._show_other()

    def _show_probe(self, part: slice) -> None:
        """Draw the elevation at the nearest probe over that of the node, at some steps of the cube."""
        data: dict[str, NDArray[np.floating]] = {"t": np.empty(0), "value": np.empty(0)}
        found = self._near()
        if found is not None:
            time, half_step = self._record.time[part], 0.5 / self._record.frame_rate
            near = found.probe.sel(time=slice(time[0] - half_step, time[-1] + half_step))
            values = near.elevation.values * display("z").factor
            data = dict(zip(("t", "value"), parts.envelope(near.time.values, values)))
        if data["t"].size or len(self.sources["probe_series"].data["t"]):
            self.sources["probe_series"].data = data

    def _show_other(self) -> None:
        name = parts.chosen(self.other)
        if self._node is None or not name:
            return
        shown, part, record = display(name), self._window(), self._record
        self.figures["other"].yaxis.axis_label = shown.label
        rows = [("t", "@t{0.000} s"), (name, f"@value{{0.[0000]}} {shown.unit}")]
        self.figures["other"].hover.tooltips = rows
        if name in DERIVED:
            j, i = self._index(record.y, record.x)
            found = self._reader.get((j, i, record.steps_done), self.layout.document)
            series = np.full(record.time.size, np.nan, np.float32) if not found else found[name]
            series = series * np.float32(shown.factor)
        else:
            series = self._series(name, shown.factor)
        t, value = parts.envelope(record.time[part], series[part])
        self.sources["other_series"].data = {"t": t, "value": value}

    def _show_quality(self) -> None:
        record = self._record
        if "quality" not in record.stored:
            return
        stored = record.preview.stored("quality")[self._index(record.preview.y, record.preview.x)]
        kinds = quality_kind(np.maximum(stored, 0))  # missing values are negative
        starts = np.flatnonzero(np.diff(kinds.astype(int), prepend=-1))
        ends = np.r_[starts[1:], kinds.size]
        named = kinds[starts] < len(KINDS)
        half_step = 0.5 / record.frame_rate
        self.sources["quality"].data = {
            "left": record.time[starts[named]] - half_step,
            "right": record.time[ends[named] - 1] + half_step,
            "kind": kinds[starts[named]].astype(np.float32),
        }

    def _show_spectrum(self) -> None:
        if self._node is not None:
            name = parts.chosen(self.spectrum.variable)
            values = self._series(name, display(name).factor)
            self.spectrum.show(values, self._record.time, self._near())

    def _zoomed(self) -> None:
        """Draw finer series for a narrower view."""
        document = self.layout.document
        fine = self._record.time.size <= parts.MOST_POINTS
        if self._node is not None and document is not None and not (fine or self._refining):
            self._refining = True
            document.add_timeout_callback(self._refine, _ZOOM_DELAY_MS)

    def _refine(self) -> None:
        self._refining = False
        self._show_series()


def _reading(name: str, values: dict[str, float]) -> str:
    """The value of a variable in words, with its uncertainty where it has one."""
    shown, value, std = display(name), values[name], values.get(f"{name}_std", np.nan)
    if not np.isfinite(value):
        return f"{name} none"
    more = f" ± {number(std * shown.factor, 2)}" if np.isfinite(std) else ""
    return f"{name} {number(value * shown.factor)}{more} {shown.unit}".rstrip()


def _ordinal(count: int) -> str:
    return {2: "second", 3: "third"}.get(count, f"{count}th")
