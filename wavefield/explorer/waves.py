"""The tab of waves: spectra E(k, omega), with the dispersion relation, and E(kx, ky) at one frequency."""

from dataclasses import replace

import numpy as np
import xarray as xr
from bokeh.layouts import column, row
from bokeh.models import LinearColorMapper, Range1d, Select, Slider, Span
from bokeh.plotting import figure
from numpy.typing import NDArray

from wavefield import water
from wavefield.errors import StoreError
from wavefield.explorer import parts
from wavefield.explorer.parts import Place, number
from wavefield.explorer.record import LookSession
from wavefield.figures.display import POSITIVE

DECADES = 6.0  # decades of the colour scale below the largest density
_WRAP = {"flex-wrap": "wrap"}


def log_density(density: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return log10(density / largest density); values below -6 become -6 (`-DECADES`).
    All are NaN if no density is positive."""
    top = float(np.nanmax(density)) if np.isfinite(density).any() else 0.0
    if top <= 0:
        return np.full(density.shape, np.nan, np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.maximum(np.log10(density / top), -DECADES), np.float32)


def doppler_relation(k: NDArray[np.floating], current: float, depth: float) -> NDArray[np.floating]:
    """Return the frequencies, Hz, at a fixed point, of free waves with wavenumbers k, rad/m, in a current.
    `current` is its component in the direction of the waves, m/s; `depth` is the water depth, m."""
    return np.asarray((water.dispersion(k, depth) + k * current) / (2 * np.pi))


class WavePanel:
    """The tab with the spectra that `wavefield analyze` wrote, and sliders for current and depth."""

    def __init__(self, session: LookSession) -> None:
        self._session = session
        depth = float(session.record.group.attrs.get("water_depth", np.inf))
        self._depth = depth if np.isfinite(depth) else 5.0  # deep water for waves of a few metres
        self._spectra: xr.Dataset | None = None
        self._chosen = 0  # index of the frequency of the map
        self.words = parts.text_line("wave_words")
        self.variable = Select(title="E(k, ω) of", value="", options=[], name="wave_variable")
        self.current = Slider(
            title="Current along the waves (m/s)", start=-0.5, end=0.5, step=0.01, value=0.0,
            name="wave_current", width=230,
        )  # fmt: skip
        top = max(1.0, float(f"{2 * self._depth:.1g}"))
        self.depth = Slider(
            title="Depth (m)", start=0.01, end=top, step=0.01, value=min(self._depth, top),
            name="wave_depth", width=230,
        )  # fmt: skip
        self.sources = parts.make_sources(
            "wave", image=parts.IMAGE, plane=parts.IMAGE, ruler="k f", circle="kx ky", window="left right",
        )  # fmt: skip
        self.picked = Span(
            dimension="width", location=0, line_color="white", line_dash="dotted", line_width=1.5
        )
        self.figures = self._draw()
        self.variable.on_change("value", lambda attr, old, new: self._show_spectrum())
        for slider in (self.current, self.depth):
            slider.on_change("value", lambda attr, old, new: self._show_relation())
        top_row = row(self.variable, self.current, self.depth, sizing_mode="stretch_width", styles=_WRAP)
        figures = self.figures["spectrum"], self.figures["map"]
        self.layout = column(self.words, top_row, *figures, sizing_mode="stretch_width")

    def _draw(self) -> dict[str, figure]:
        source = self.sources
        mapper = LinearColorMapper(palette=parts.palette(POSITIVE), low=-DECADES, high=0, nan_color="#00224e")
        spectrum = parts.make_figure(
            "wave_spectrum", height=340, tools="pan,wheel_zoom,box_zoom,reset,save", toolbar_location="above",
            x_axis_label="k / 2π (1/m)", y_axis_label="ω / 2π (Hz)", x_range=Range1d(0, 1),
            y_range=Range1d(0, 1),
        )  # fmt: skip
        spectrum.image("image", source=source["image"], color_mapper=mapper)
        spectrum.line("k", "f", source=source["ruler"], color="white", line_width=4)
        spectrum.line("k", "f", source=source["ruler"], color=parts.INK, line_width=1.8, line_dash=[7, 4])
        parts.add_hover(
            spectrum, ("k / 2π", "$x{0.00} 1/m"), ("ω / 2π", "$y{0.00} Hz"),
            ("log₁₀(E / largest E)", "@image{0.00}"), renderers=spectrum.renderers[:1],
        )  # fmt: skip
        spectrum.add_layout(self.picked)
        spectrum.add_layout(parts.colour_bar(mapper), "right")
        parts.on_click(spectrum, lambda event: self.choose(event.y))
        plane = parts.make_figure(  # kx and ky on equal axes
            "wave_map", height=340, min_width=280, match_aspect=True,
            tools="pan,wheel_zoom,reset,save", toolbar_location="above",
            x_axis_label="kx / 2π (1/m)", y_axis_label="ky / 2π (1/m)",
        )  # fmt: skip
        window = plane.quad(
            "left", "right", "left", "right", source=source["window"], fill_color=None, line_color=None
        )
        for axis in (plane.x_range, plane.y_range):
            axis.update(renderers=[window], range_padding=0.0)
        image = plane.image("image", source=source["plane"], color_mapper=mapper)
        plane.line("kx", "ky", source=source["circle"], color="white", line_dash=[6, 4], line_width=1.6)
        parts.add_hover(
            plane, ("kx, ky / 2π", "$x{0.00}, $y{0.00} 1/m"),
            ("log₁₀(E / largest E)", "@image{0.00}"), renderers=[image],
        )  # fmt: skip
        return {"spectrum": spectrum, "map": plane}

    # -- showing ---------------------------------------------------------------------------------------

    def show(self, place: Place) -> None:
        """Draw the spectra of the whole record when they exist; later calls do nothing. `place` is unused."""
        if self._spectra is not None:
            return
        session = self._session
        try:
            if session.run.waves is None and session.run.waves_path.is_dir():  # written meanwhile
                session.run = replace(session.run)  # reads the files again
            self._spectra = session.run.wave_group("spectra")
        except StoreError as error:
            self.words.text = str(error)
            return
        if self._spectra is None:
            self.words.text = f"{session.run.reason('waves')}; this page shows them when they exist"
            return
        options = [str(name) for name in self._spectra["quantity"].values]
        self.words.text = "Click E(k, ω) to choose the frequency of the map."
        self.variable.update(options=options, value="w" if "w" in options else options[0])
        self._show_spectrum()

    def _show_spectrum(self) -> None:
        if self._spectra is None or not parts.chosen(self.variable):
            return
        energy = self._spectra["E"].sel(quantity=parts.chosen(self.variable)).transpose("omega", "k")
        hertz, cycles = energy.omega.values / (2 * np.pi), energy.k.values / (2 * np.pi)
        density = log_density(energy.values)
        self.sources["image"].data = parts.image_data(density, cycles, hertz)
        shortest = float(water.wavenumber(2 * np.pi * hertz[-1], self._depth)) / (2 * np.pi)
        drawn = cycles[(density > -DECADES).any(axis=0)]  # wavenumbers above the lowest colour
        end = min(float(drawn[-1] if drawn.size else cycles[-1]), 1.25 * shortest)
        self.figures["spectrum"].x_range.update(start=0, end=end)
        self.figures["spectrum"].y_range.update(start=0, end=float(hertz[-1]))
        title = f"log₁₀ of E(k, ω) of {parts.chosen(self.variable)}, relative to its maximum"
        self.figures["spectrum"].title.text = title
        self._show_relation()
        self._show_map()

    def _show_relation(self) -> None:
        if self._spectra is None:
            return
        k = np.linspace(1e-3, float(self._spectra.k.values[-1]), 400)
        frequency = doppler_relation(k, self.current.value, self.depth.value)
        self.sources["ruler"].data = {"k": k / (2 * np.pi), "f": frequency}
        self._show_circle()

    def choose(self, frequency: float) -> None:
        """Draw E(kx, ky) at the frequency nearest to `frequency`, Hz, of those in the wave store."""
        if self._spectra is None or "omega_map" not in self._spectra.coords:
            return
        hertz = self._spectra.omega_map.values / (2 * np.pi)
        self._chosen = int(np.argmin(np.abs(hertz - frequency)))
        self._show_map()

    def _show_map(self) -> None:
        spectra, name = self._spectra, parts.chosen(self.variable)
        if spectra is None or "E_kxky" not in spectra:
            return
        name = name if name in spectra["quantity_map"].values else "w"
        energy = spectra["E_kxky"].isel(omega_map=self._chosen).sel(quantity_map=name).transpose("ky", "kx")
        kx, ky = energy.kx.values / (2 * np.pi), energy.ky.values / (2 * np.pi)
        self.sources["plane"].data = parts.image_data(log_density(energy.values), kx, ky)
        hertz = float(energy.omega_map) / (2 * np.pi)
        self.picked.location = hertz
        title = f"E(kx, ky) of {name} at {number(hertz)} Hz, the nearest frequency stored"
        self.figures["map"].title.text = title
        self._show_circle()

    def _show_circle(self) -> None:
        spectra = self._spectra
        if spectra is None or "omega_map" not in spectra.coords:
            return
        omega = float(spectra.omega_map.values[self._chosen])
        radius = float(water.wavenumber(omega, self.depth.value)) / (2 * np.pi)
        turn = np.linspace(0, 2 * np.pi, 181)
        self.sources["circle"].data = {"kx": radius * np.cos(turn), "ky": radius * np.sin(turn)}
        half = min(3 * radius, float(np.abs(spectra.kx.values).max()) / (2 * np.pi))
        self.sources["window"].data = {"left": [-half], "right": [half]}
