"""The spectrum at a node with its confidence interval, and that of a wave probe near it."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from bokeh.models import ColumnDataSource, Select
from bokeh.plotting import figure
from numpy.typing import NDArray

from wavefield.explorer import plot_parts as parts
from wavefield.explorer.plot_parts import number
from wavefield.explorer.selections import Spectrum, spectrum
from wavefield.figures.display import Display, display

if TYPE_CHECKING:
    import xarray as xr

MAX_PROBE_DISTANCE_M = 0.25  # a probe farther away measures other waves


class NearProbe(NamedTuple):
    """A wave probe near a node."""

    probe: "xr.Dataset"  # elevation (time,), metres
    distance: float  # metres

    @property
    def words(self) -> str:
        """Which one it is."""
        return f"{self.probe.probe.item()}, {100 * self.distance:.0f} cm away"


def nearest_probe(probes: "xr.Dataset | None", x: float, y: float) -> NearProbe | None:
    """The nearest of the probes to a point, metres, if it is near."""
    if probes is None:
        return None
    distance = np.nan_to_num(np.hypot(probes.probe_x.values - x, probes.probe_y.values - y), nan=np.inf)
    k = int(np.argmin(distance))
    if distance[k] > MAX_PROBE_DISTANCE_M:
        return None
    return NearProbe(probes.isel(probe=k), float(distance[k]))


def spectrum_figure(name: str, source: ColumnDataSource, height: int, **line: object) -> figure:
    """A figure of a spectrum with its confidence interval; `line`: settings of its curve."""
    made = parts.make_figure(
        name, height=height, x_axis_type="log", y_axis_type="log", x_axis_label="frequency (Hz)",
        tools="pan,wheel_zoom,reset",
    )  # fmt: skip
    parts.draw_band(made, source, "f", "e", **line)
    parts.add_hover(made, renderers=made.renderers[1:2], mode="vline")
    return made


def show_spectrum(
    made: figure, source: ColumnDataSource, found: Spectrum | None, shown: Display, words: str
) -> None:
    """Show a spectrum of a variable in its displayed unit; its interval is stated in words."""
    unit = f"({shown.unit})²/Hz"
    made.yaxis.axis_label = f"E {unit}"
    made.hover.tooltips = [("frequency", "@f{0.000} Hz"), (f"E of {shown.name}", f"@e {unit}")]
    if found is None:
        parts.clear(source)
        made.title.text = "too short a record without gaps for a spectrum"
        return
    e, low, high = found.density, found.low, found.high
    source.data = {"f": found.frequency, "e": e, "low": e * low, "high": e * high}
    made.title.text = f"{words}: {number(low, 2)} to {number(high, 2)} times"


class NodeSpectrum:
    """Spectra at the picked node."""

    def __init__(self, names: tuple[str, ...], frame_rate: float) -> None:
        self._frame_rate = frame_rate
        self.variable = Select(title="Spectrum of", value="z", options=list(names), name="node_which")
        self.sources = parts.make_sources("node", spectrum="f e low high", probe_spectrum="f e")
        made = spectrum_figure(
            "node_spectrum_figure", self.sources["spectrum"], 190, legend_label="this node"
        )
        made.line(
            "f", "e", source=self.sources["probe_spectrum"], color=parts.VERMILION, line_width=1.6,
            line_dash="dashed", legend_label="probe",
        )  # fmt: skip
        made.legend.update(
            location="bottom_left", label_text_font_size="11px", background_fill_alpha=0.7, padding=4
        )
        self.figure = made

    def show(self, values: NDArray[np.floating], time: NDArray[np.floating], near: NearProbe | None) -> None:
        """Show the spectrum of a series (time,) of the chosen variable in its displayed unit."""
        name = parts.chosen(self.variable)
        shown = display(name)
        found = spectrum(values, 1.0 / self._frame_rate)
        words = f"spectrum of {name}; 95 % interval"
        show_spectrum(self.figure, self.sources["spectrum"], found, shown, words)
        parts.clear(self.sources["probe_spectrum"])
        self.figure.legend.visible = False
        if name == "z" and near is not None:
            segment = None if found is None else float(1 / found.frequency[0])
            self._show_probe(near, time, shown.factor, segment)

    def _show_probe(
        self, near: NearProbe, time: NDArray[np.floating], factor: float, segment_s: float | None
    ) -> None:
        """Show the spectrum of a probe over the time of the cube, with segments as long as the node's."""
        probe, t = near.probe, near.probe.time.values
        within = (t >= time[0]) & (t <= time[-1])
        found = spectrum(probe.elevation.values[within] * factor, float(np.mean(np.diff(t))), segment_s)
        if found is not None:
            keep = found.frequency <= self._frame_rate / 2
            self.sources["probe_spectrum"].data = {"f": found.frequency[keep], "e": found.density[keep]}
            self.figure.legend.visible = True
            self.figure.legend.items[1].label = {"value": near.words}
