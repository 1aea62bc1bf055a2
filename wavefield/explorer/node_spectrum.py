"""The spectrum at a node with its confidence interval, and that of a wave probe near it."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from bokeh.models import Select
from numpy.typing import NDArray

from wavefield.explorer.plot_parts import (
    VERMILION,
    add_hover,
    chosen,
    clear,
    draw_band,
    make_figure,
    make_sources,
    number,
)
from wavefield.explorer.selections import spectrum, spectrum_columns
from wavefield.figures.display import display

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


class NodeSpectrum:
    """Spectra at the picked node."""

    def __init__(self, names: tuple[str, ...], frame_rate: float) -> None:
        self._frame_rate = frame_rate
        self.variable = Select(title="Spectrum of", value="z", options=list(names), name="node_which")
        self.sources = make_sources("node", spectrum="f e low high", probe_spectrum="f e")
        made = make_figure(
            "node_spectrum_figure", height=190, x_axis_type="log", y_axis_type="log",
            x_axis_label="frequency (Hz)", tools="pan,wheel_zoom,reset",
        )  # fmt: skip
        draw_band(made, self.sources["spectrum"], "f", "e", legend_label="this node")
        made.line(
            "f", "e", source=self.sources["probe_spectrum"], color=VERMILION, line_width=1.6,
            line_dash="dashed", legend_label="probe",
        )  # fmt: skip
        self.hover = add_hover(
            made, ("frequency", "@f{0.000} Hz"), renderers=made.renderers[1:2], mode="vline"
        )
        made.legend.update(
            location="bottom_left", label_text_font_size="11px", background_fill_alpha=0.7, padding=4
        )
        self.figure = made

    def show(self, values: NDArray[np.floating], time: NDArray[np.floating], near: NearProbe | None) -> None:
        """Show the spectrum of a series (time,) of the chosen variable in its displayed unit."""
        name = chosen(self.variable)
        shown = display(name)
        found = spectrum(values, 1.0 / self._frame_rate)
        self.figure.yaxis.axis_label = f"E ({shown.unit})²/Hz"
        self.hover.tooltips = [("frequency", "@f{0.000} Hz"), (f"E of {name}", f"@e ({shown.unit})²/Hz")]
        self.sources["spectrum"].data = spectrum_columns(found)
        clear(self.sources["probe_spectrum"])
        self.figure.legend.visible = False
        if found is None:
            self.figure.title.text = "too short a record without gaps for a spectrum"
        else:
            self.figure.title.text = (
                f"spectrum of {name}; 95 % interval: {number(found.low, 2)} to {number(found.high, 2)} times"
            )
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
