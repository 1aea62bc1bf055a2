"""The tab of one grid node: time series with uncertainty and quality, a spectrum, and a nearby wave probe."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from bokeh.layouts import column
from bokeh.models import Select, Span
from bokeh.plotting import figure
from numpy.typing import NDArray

from wavefield.explorer import parts
from wavefield.explorer.parts import Place, number
from wavefield.explorer.record import CubeRecord, nearest
from wavefield.figures.display import KINDS, display, quality_kind

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.floating]
MAX_PROBE_DISTANCE_M = 0.05  # a probe farther away measures other phases of short waves
_MAIN = ("z", "u", "v", "w")
MIN_STEPS_OF_SPECTRUM = 32  # shortest series of which a spectrum is shown; it has one Welch segment


class Spectrum(NamedTuple):
    """A one-sided power spectrum with its confidence interval."""

    frequency: Array  # (n,): Hz; without 0
    density: Array  # (n,): unit of the values squared per Hz; sum times frequency step is the variance
    low: float  # the true density is between low and high times `density` with 95 % confidence
    high: float


def longest_run(values: Array) -> Array:
    """Return the longest part of a series (n,) without gaps of more than two missing values (NaN).
    Shorter gaps are filled by linear interpolation, as in `wavefield analyze`."""
    from wavefield.waves.record import LONGEST_BRIDGE  # takes a second to import

    finite = np.flatnonzero(np.isfinite(values))
    if not finite.size:
        return np.empty(0)
    pieces = np.split(finite, np.flatnonzero(np.diff(finite) > LONGEST_BRIDGE + 1) + 1)
    longest = max(pieces, key=lambda piece: int(piece[-1] - piece[0]))
    steps = np.arange(longest[0], longest[-1] + 1)
    return np.asarray(np.interp(steps, longest, values[longest]))


def spectrum(values: Array, dt: float) -> Spectrum | None:
    """Return the Welch spectrum of the longest part of a series (n,) without gaps of over two values.
    None if this part has fewer than 32 values. `dt` is the time step, s. Segments and degrees of freedom are
    chosen as in `wavefield analyze`."""
    from scipy import signal  # takes most of a second to import

    from wavefield.waves.welch import choose_segment, degrees_of_freedom, interval, segment_count

    run = longest_run(np.asarray(values, float))
    if run.size < MIN_STEPS_OF_SPECTRUM:
        return None
    segment = choose_segment(run.size)
    frequency, density = signal.welch(run, fs=1 / dt, nperseg=segment, detrend="constant")
    low, high = interval(degrees_of_freedom(segment_count(run.size, segment)))
    return Spectrum(frequency[1:], density[1:], float(low), float(high))


def nearest_probe(probes: "xr.Dataset | None", x: float, y: float, reach: float) -> "xr.Dataset | None":
    """Return the probe nearest to a point x, y, or None if none is within `reach` (all in metres)."""
    if probes is None:
        return None
    distance = np.nan_to_num(np.hypot(probes.probe_x.values - x, probes.probe_y.values - y), nan=np.inf)
    k = int(np.argmin(distance))
    return probes.isel(probe=k) if distance[k] <= reach else None


class NodePanel:
    """The tab with time series, quality and spectrum at the grid node that the user picked."""

    def __init__(self, record: CubeRecord) -> None:
        self._record = record
        self.probes: xr.Dataset | None = None  # of the experiment, when they are read
        self._node: tuple[float, float] | None = None  # x and y of the picked node, m
        self._main = tuple(name for name in _MAIN if name in record.stored)
        self.words = parts.text_line("node_words", "Click a node of the map.", html=True)
        self.which = Select(title="Spectrum of", value="z", options=list(self._main), name="node_which")
        # One source per figure. The browser paints what arrives together once, but only if it fits into its
        # buffer of 128 kB; otherwise it paints half of it first.
        series = {f"{name}_series": "t value low high" for name in self._main}
        more = {"quality": "left right kind", "probe_series": "t value"}
        self.sources = parts.make_sources("node", **series, **more, spectrum="f e low high")
        self.now = Span(dimension="height", location=0, line_color=parts.INK, line_dash="dotted")
        self.figures: dict[str, figure] = {}
        for name in self._main:
            self.figures[name] = self._draw_series(name)
        self.spectrum = self._draw_spectrum()
        self.which.on_change("value", lambda attr, old, new: self._show_spectrum())
        self.layout = column(
            self.words, *self.figures.values(), self._draw_strip(), self.which, self.spectrum,
            sizing_mode="stretch_width",
        )  # fmt: skip

    def _draw_series(self, name: str) -> figure:
        time, source = self._record.time, self.sources[f"{name}_series"]
        x_range = next(iter(self.figures.values())).x_range if self.figures else (time[0], time[-1])
        made = parts.make_figure(
            f"node_{name}_figure", height=84, x_range=x_range,
            y_axis_label=display(name).label,
        )  # fmt: skip
        made.xaxis.visible = False
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
            "node_strip", height=66, x_range=next(iter(self.figures.values())).x_range, y_range=(0, 1),
            x_axis_label="t (s); strip: quality",
        )  # fmt: skip
        colour = {"field": "kind", "transform": parts.quality_mapper()}
        made.quad("left", "right", 0, 1, source=self.sources["quality"], fill_color=colour, line_color=None)
        made.yaxis.update(ticker=[], axis_label="")
        made.ygrid.visible = False
        return made

    def _draw_spectrum(self) -> figure:
        made = parts.make_figure(
            "node_spectrum_figure", height=190, x_axis_type="log", y_axis_type="log",
            x_axis_label="frequency (Hz)", tools="pan,wheel_zoom,reset",
        )  # fmt: skip
        parts.draw_band(made, self.sources["spectrum"], "f", "e")
        parts.add_hover(made, renderers=made.renderers[1:2], mode="vline")
        return made

    # -- showing ---------------------------------------------------------------------------------------

    def show(self, place: Place) -> None:
        """Show values, series, quality and spectrum at the picked node in `place`, the state of the page."""
        self.show_step(place)
        if self._node is not None:
            self._show_series()
            self._show_quality()
            self._show_spectrum()

    def show_step(self, place: Place) -> None:
        """Show the values at the node and step in `place`, the page's state; do not draw the series again."""
        record, self._node = self._record, place.node
        self.now.location = float(record.time[place.step])
        if self._node is None:
            return
        j, i = self._index(record.y, record.x)
        values = {name: float(record.field(name, place.step)[j, i]) for name in record.stored}
        kind = quality_kind(np.array([int(values.get("quality", 0))]))[0]
        others = [n for n in record.stored if n not in (*_MAIN, "quality") and not n.endswith("_std")]
        every, near = record.preview.thin.every, self._near_probe()
        away = near and 100 * np.hypot(near.probe_x - record.x[i], near.probe_y - record.y[j]).item()
        self.words.text = (
            f"<b>x {number(record.x[i], 4)} m, y {number(record.y[j], 4)} m, "
            f"t {record.time[place.step]:.3f} s:</b> "
            f"{', '.join(_reading(name, values) for name in (*self._main, *others))}; "
            f"{KINDS[kind][1] if kind < len(KINDS) else 'nothing measured'}."
            + (f" Series: nearest node of the preview (one in {every} along x and y)." if every > 1 else "")
            + (f" Dashed: {parts.plain(near.probe.item())}, {away:.0f} cm away." if near is not None else "")
        )

    def _index(self, y: Array, x: Array) -> tuple[int, int]:
        """Return the indices (j, i) on axes y (ny,) and x (nx,) of the node nearest to the picked node."""
        assert self._node is not None
        return nearest(y, self._node[1]), nearest(x, self._node[0])

    def _near_probe(self) -> "xr.Dataset | None":
        """Return the probe nearest to the picked node, at most 5 cm or one grid step away, or else None."""
        record = self._record
        j, i = self._index(record.y, record.x)
        spacing = abs(float(record.x[-1] - record.x[0])) / max(record.x.size - 1, 1)
        return nearest_probe(self.probes, record.x[i], record.y[j], max(MAX_PROBE_DISTANCE_M, spacing))

    def _series(self, name: str, unit_of: str = "") -> Array:
        """Return a variable over time, (time,), at the node of the thinned cube nearest to the picked node.
        It is in the unit in which the variable `unit_of`, by default `name`, is displayed."""
        preview, factor = self._record.preview, display(unit_of or name).factor
        return preview.series(name, *self._index(preview.y, preview.x)) * np.float32(factor)

    def _show_series(self) -> None:
        time = self._record.time
        for name in self._main:
            values = self._series(name)
            std = np.full_like(values, np.nan)
            if f"{name}_std" in self._record.stored:
                std = self._series(f"{name}_std", unit_of=name)
            self.sources[f"{name}_series"].data = parts.envelope(time, values, std)
        self._show_probe()

    def _show_probe(self) -> None:
        """Draw the elevation of the nearest probe on the figure of z; remove it if no probe is near."""
        data: dict[str, Array] = {"t": np.empty(0), "value": np.empty(0)}
        near = self._near_probe()
        if near is not None:
            time, half_step = self._record.time, 0.5 / self._record.frame_rate
            near = near.sel(time=slice(time[0] - half_step, time[-1] + half_step))
            values = near.elevation.values * display("z").factor
            drawn = parts.envelope(near.time.values, values, np.zeros_like(values))
            data = {name: drawn[name] for name in data}
        if data["t"].size or len(self.sources["probe_series"].data["t"]):
            self.sources["probe_series"].data = data

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
        name = parts.chosen(self.which)
        if self._node is None or not name:
            return
        shown = display(name)
        unit = f"({shown.unit})²/Hz"
        found = spectrum(self._series(name), 1.0 / self._record.frame_rate)
        self.spectrum.yaxis.axis_label = f"E {unit}"
        self.spectrum.hover.tooltips = [("frequency", "@f{0.000} Hz"), (f"E of {name}", f"@e {unit}")]
        if found is None:
            parts.clear(self.sources["spectrum"])
            self.spectrum.title.text = (
                f"No spectrum: it needs {MIN_STEPS_OF_SPECTRUM} steps in a row at this node."
            )
            return
        e = found.density
        self.sources["spectrum"].data = {
            "f": found.frequency, "e": e, "low": e * found.low, "high": e * found.high,
        }  # fmt: skip
        factors = f"{number(found.low, 2)} to {number(found.high, 2)}"
        self.spectrum.title.text = f"95 % interval: {factors} times the curve"


def _reading(name: str, values: dict[str, float]) -> str:
    """Return a variable as text such as "z 1.2 ± 0.1 cm", with its standard uncertainty if there is one.
    `values` holds the variables at a node, in the units of the cube."""
    shown, value, std = display(name), values[name], values.get(f"{name}_std", np.nan)
    if not np.isfinite(value):
        return f"{name} none"
    more = f" ± {number(std * shown.factor, 2)}" if np.isfinite(std) else ""
    return f"{name} {number(value * shown.factor)}{more} {shown.unit}".rstrip()
