"""Waves: E(k, omega) with a ruler for the dispersion relation, maps at a frequency, coherence, directions."""

from typing import Any

import numpy as np
import xarray as xr
from bokeh.events import DoubleTap, Tap
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, Div, LinearColorMapper, Range1d, Select, Slider, Span
from numpy.typing import NDArray

from wavefield import water
from wavefield.explorer.context import CubeContext, open_waves
from wavefield.explorer.map_fields import palette
from wavefield.explorer.plot_parts import (
    BLUE,
    GREEN,
    INK,
    VERMILION,
    colour_bar,
    image_data,
    image_source,
    make_figure,
    number,
)

_DECADES = 6.0  # shown below the largest
_PREFIX, _MAP_PREFIX = "E_komega_", "E_kxky_"


def log_density(density: NDArray[Any], decades: float = _DECADES) -> NDArray[np.float32]:
    """Decimal logarithm of a density relative to its largest value."""
    top = float(np.nanmax(density)) if np.isfinite(density).any() else 0.0
    if top <= 0:
        return np.full(density.shape, np.nan, np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.maximum(np.log10(density / top), -decades).astype(np.float32)


def ruler(k: NDArray[Any], current: float, depth: float) -> NDArray[Any]:
    """Frequency of waves of given length that run with a current.

    With k (n,), rad/m; current, m/s; returns (n,): Hz, as a camera at rest sees it: (omega(k) + k U) / 2 pi.
    """
    return np.asarray((water.dispersion(k, depth) + k * current) / (2 * np.pi))


class WavePanel:
    """What `wavefield analyze` found."""

    def __init__(self, beside: CubeContext, depth: float) -> None:
        self._beside = beside
        self._depth = depth if np.isfinite(depth) else 5.0
        self.words = Div(text=beside.notes.get("waves", ""), name="wave_words", sizing_mode="stretch_width")
        self.variable = Select(title="E(k, \u03c9) of", value="", options=[], name="wave_variable")
        self.current = Slider(
            title="Current along the waves (m/s)",
            start=-0.5,
            end=0.5,
            step=0.01,
            value=0.0,
            name="wave_current",
        )
        top = max(1.0, float(f"{2 * self._depth:.1g}"))
        self.depth = Slider(
            title="Depth (m)", start=0.01, end=top, step=0.01, value=min(self._depth, top), name="wave_depth"
        )
        self.image, self.plane = image_source("wave_image"), image_source("wave_plane")
        self.ruler = ColumnDataSource({"k": [], "f": []}, name="wave_ruler")
        self.circle = ColumnDataSource({"kx": [], "ky": []}, name="wave_circle")
        self.coherence = ColumnDataSource(
            {"k": [], "w": [], "nl": [], "tot": [], "level": []}, name="wave_coherence"
        )
        self.direction = ColumnDataSource({"angle": [], "density": []}, name="wave_direction")
        self._spectra: xr.Dataset | None = None
        self._chosen = 0
        self._draw()
        for widget in (self.variable,):
            widget.on_change("value", lambda attr, old, new: self._show_spectrum())
        for slider in (self.current, self.depth):
            slider.on_change("value", lambda attr, old, new: self._show_ruler())
        wrap = {"flex-wrap": "wrap"}
        for slider in (self.current, self.depth):
            slider.update(width=230)
        controls = row(self.variable, self.current, self.depth, sizing_mode="stretch_width", styles=wrap)
        below = row(self.map, self.directions, sizing_mode="stretch_width", styles=wrap)
        self.layout = column(
            self.words, controls, self.figure, below, self.curves, sizing_mode="stretch_width"
        )
        self._loaded = False

    def _draw(self) -> None:
        self.mapper = LinearColorMapper(
            palette=palette("cividis"), low=-_DECADES, high=0, nan_color="#00224e"
        )
        self.figure = make_figure(
            "wave_spectrum", height=340, tools="pan,wheel_zoom,box_zoom,reset,save", toolbar_location="above",
            x_axis_label="k / 2\u03c0 (1/m)", y_axis_label="\u03c9 / 2\u03c0 (Hz)",
            x_range=Range1d(0, 1), y_range=Range1d(0, 1),
        )  # fmt: skip
        self.figure.image("image", source=self.image, color_mapper=self.mapper)
        self.figure.line("k", "f", source=self.ruler, color="white", line_width=4)
        self.figure.line("k", "f", source=self.ruler, color=INK, line_width=1.8, line_dash=[7, 4])
        self.picked = Span(
            dimension="width", location=0, line_color="white", line_dash="dotted", line_width=1.5
        )
        self.figure.add_layout(self.picked)
        self.figure.add_layout(colour_bar(self.mapper), "right")
        for tap in (Tap, DoubleTap):  # a second click within .3 s is no tap, wherever it is
            self.figure.on_event(tap, lambda event: self.choose(event.y))
        self.map = make_figure(
            "wave_map", height=300, min_width=280, match_aspect=True, tools="pan,wheel_zoom,reset,save",
            x_axis_label="kx / 2\u03c0 (1/m)", y_axis_label="ky / 2\u03c0 (1/m)",
            x_range=Range1d(-1, 1), y_range=Range1d(-1, 1),
        )  # fmt: skip
        self.map.image("image", source=self.plane, color_mapper=self.mapper)
        self.map.line("kx", "ky", source=self.circle, color="white", line_dash=[6, 4], line_width=1.6)
        self.directions = make_figure(
            "wave_directions",
            height=300,
            min_width=280,
            x_axis_label="direction (degrees)",
            y_axis_label="D (1/rad)",
            tools="reset",
        )
        self.directions.line("angle", "density", source=self.direction, color=BLUE, line_width=1.8)
        self.curves = make_figure(
            "wave_coherence_figure", height=240,
            x_axis_label="k / 2\u03c0 (1/m)", y_axis_label="coherence \u03b3\u00b2",
            x_range=Range1d(0, 1), y_range=Range1d(0, 1.02), tools="xpan,xwheel_zoom,reset",
        )  # fmt: skip
        styles = (
            ("w", "z_t with w", BLUE, "solid"),
            ("nl", "z_t with \u2212u\u00b7\u2207z", VERMILION, "dashed"),
            ("tot", "z_t with both", INK, "dotdash"),
            ("level", "chance, 5 %", GREEN, "dotted"),
        )
        for name, label, colour, dash in styles:
            self.curves.line(
                "k",
                name,
                source=self.coherence,
                color=colour,
                line_dash=dash,
                line_width=1.8,
                legend_label=label,
            )
        self.curves.legend.label_text_font_size = "11px"
        self.curves.legend.background_fill_alpha = 0.7

    # -- showing ---------------------------------------------------------------------------------------

    def show(self) -> None:
        """Show the waves; looks for them first, if they were not there before."""
        if self._loaded:
            return
        if self._beside.waves is None:
            open_waves(self._beside)
            self.words.text = self._beside.notes.get("waves", "")
        self._spectra = self._beside.group("spectra")
        if self._spectra is None:
            return
        self._loaded = True
        options = [
            str(n).removeprefix(_PREFIX) for n in self._spectra.data_vars if str(n).startswith(_PREFIX)
        ]
        self.words.text = "Click E(k, \u03c9) to choose a frequency for the map and the directions."
        self._show_coherence()
        self.variable.update(options=options, value="w" if "w" in options else options[0])
        self._show_spectrum()

    def _show_spectrum(self) -> None:
        if self._spectra is None or not self.variable.value:
            return
        energy = self._spectra[_PREFIX + self.variable.value].transpose("omega", "k")
        hertz, cycles = energy.omega.values / (2 * np.pi), energy.k.values / (2 * np.pi)
        self.image.data = image_data(log_density(energy.values), cycles, hertz)
        right = float(cycles[-1])
        fastest = float(water.wavenumber(2 * np.pi * hertz[-1], self._depth)) / (2 * np.pi)
        for drawn in (self.figure, self.curves):
            drawn.x_range.update(start=0, end=min(right, 1.25 * fastest))
        self.figure.y_range.update(start=0, end=float(hertz[-1]))
        self.figure.title.text = (
            f"log\u2081\u2080 of E(k, \u03c9) of {self.variable.value}, relative to its largest"
        )
        self._show_ruler()
        self._show_map()

    def _show_ruler(self) -> None:
        if self._spectra is None:
            return
        k = np.linspace(1e-3, float(self._spectra.k.values[-1]), 400)
        f = ruler(k, self.current.value, self.depth.value)
        self.ruler.data = {"k": k / (2 * np.pi), "f": f}
        self._show_circle()

    def choose(self, frequency: float) -> None:
        """Show the map and the directions nearest a frequency."""
        if self._spectra is None or "omega_map" not in self._spectra.coords:
            return
        hertz = self._spectra.omega_map.values / (2 * np.pi)
        self._chosen = int(np.argmin(np.abs(hertz - frequency)))
        self._show_map()

    def _show_map(self) -> None:
        spectra = self._spectra
        if spectra is None or "omega_map" not in spectra.coords:
            return
        name = self.variable.value if _MAP_PREFIX + self.variable.value in spectra else "w"
        if _MAP_PREFIX + name not in spectra:
            return
        energy = spectra[_MAP_PREFIX + name].isel(omega_map=self._chosen).transpose("ky", "kx")
        kx, ky = energy.kx.values / (2 * np.pi), energy.ky.values / (2 * np.pi)
        self.plane.data = image_data(log_density(energy.values), kx, ky)
        hertz = float(energy.omega_map) / (2 * np.pi)
        self.picked.location = hertz
        self.map.title.text = f"E(kx, ky) of {name} at {number(hertz)} Hz, the nearest stored"
        self._show_circle()
        self._show_directions()

    def _show_circle(self) -> None:
        spectra = self._spectra
        if spectra is None or "omega_map" not in spectra.coords:
            return
        omega = float(spectra.omega_map.values[self._chosen])
        radius = float(water.wavenumber(omega, self.depth.value)) / (2 * np.pi)
        turn = np.linspace(0, 2 * np.pi, 181)
        self.circle.data = {"kx": radius * np.cos(turn), "ky": radius * np.sin(turn)}
        largest = float(np.abs(spectra.kx.values).max()) / (2 * np.pi)
        half = min(3 * radius, largest)
        self.map.x_range.update(start=-half, end=half)
        self.map.y_range.update(start=-half, end=half)

    def _show_directions(self) -> None:
        found = self._beside.group("direction")
        if found is None or "D" not in found:
            return
        omega = float(self._spectra.omega_map.values[self._chosen])  # type: ignore[union-attr]
        at = found.D.sel(omega_map=omega, method="nearest")
        angle = np.degrees(at.theta.values)
        self.direction.data = {"angle": angle, "density": at.values}
        hertz = float(at.omega_map) / (2 * np.pi)
        self.directions.title.text = f"where the waves of {number(hertz)} Hz go"

    def _show_coherence(self) -> None:
        found: Any = self._beside.group("coherence")
        if found is None or "gamma2_w" not in found:
            return
        self.coherence.data = {
            "k": found.k.values / (2 * np.pi),
            "w": found.gamma2_w.values,
            "nl": found.gamma2_nl.values,
            "tot": found.gamma2_tot.values,
            "level": found.level_w.values,
        }
