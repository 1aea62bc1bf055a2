"""Waves that are not linear: free and bound ones, coherences of three and four waves."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from wavefield.figures.display import POSITIVE
from wavefield.figures.style import HERTZ, LINES, draw_cells, draw_curves, finish, hertz, panels


def bound_spectra(bound: xr.Dataset) -> Figure:
    """Spectra of the free and of the bound waves.

    Parameters
    ----------
    bound : Dataset
        Group ``/bound`` of a wave store, or the result of `wavefield.free_and_bound`.

    Returns
    -------
    Figure
    """
    figure, [[ax]] = panels(1, width=7.2, height=4.4)
    top = float(bound.E_free.max())
    names = {
        "E_free": "free waves",
        "E_bound": "bound waves",
        "E_harmonic": "of these on the second harmonic",
    }
    spectra = {label: bound[name].values for name, label in names.items()}
    curves = {label: np.where(E > 1e-9 * top, E, np.nan) for label, E in spectra.items()}
    draw_curves(ax, hertz(bound), curves, log="y")
    fraction, std = 100 * float(bound.bound_fraction), 100 * float(bound.bound_fraction_std)
    title = f"bound: {fraction:.2g} ± {std:.1g} % of the variance"
    finish(ax, HERTZ, "E$^z$(ω) (m² s rad⁻¹)", ylim=(1e-7 * top, 3 * top), title=title)
    return figure


def resonance_map(resonances: xr.Dataset) -> Figure:
    """The significant quartets over the k plane, and the mean coherence on resonance and off it.

    Parameters
    ----------
    resonances : Dataset
        Group ``/resonances`` of a wave store, or the result of `wavefield.resonances`.

    Returns
    -------
    Figure

    Notes
    -----
    Left: k1 and k2 as points, k3 and k4 as circles, joined by the parallelogram that they span; the ten least
    probable ones, each in a colour of its own. Right: squared coherence of all quartets less that of
    surrogates against the frequency by which the fourth wave is off the dispersion relation.
    """
    figure, [[left, right]] = panels(2, height=4.4)
    kx, ky = (resonances[f"quartet_k{axis}"].values / (2 * np.pi) for axis in "xy")
    significant = np.flatnonzero(resonances.quartet_significant.values)
    for style, i in zip(LINES * 2, significant[:10], strict=False):
        left.plot(kx[i, [0, 2, 1, 3, 0]], ky[i, [0, 2, 1, 3, 0]], color=style["color"], linewidth=0.8)
        left.plot(kx[i, :2], ky[i, :2], "o", color=style["color"])
        left.plot(kx[i, 2:], ky[i, 2:], "o", color=style["color"], markerfacecolor="white")
    if significant.size:
        left.plot([], [], "o", color="0.3", label="k₁, k₂")
        left.plot([], [], "o", color="0.3", markerfacecolor="white", label="k₃, k₄")
    half = 1.1 * max(float(np.abs(kx).max(initial=0)), float(np.abs(ky).max(initial=0)), 1.0)
    title = f"{significant.size} significant of {int(resonances.quartet_tests)} quartets"
    left.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
    finish(left, "kx / 2π (m⁻¹)", "ky / 2π (m⁻¹)", title=title)
    mismatch = resonances.mismatch.values / (2 * np.pi)
    excess, std = resonances.coherence_excess.values, resonances.coherence_excess_std.values
    right.errorbar(mismatch, 1e3 * excess, 2e3 * std, fmt="o-", color="#0072B2", capsize=3)
    right.axhline(0.0, color="0.5", linewidth=0.8)
    finish(right, "frequency off resonance (Hz)", "10³ (mean γ² − surrogates)")
    return figure


def quartet_map(resonances: xr.Dataset) -> Figure:
    """Squared coherence of the quartets of two fixed waves over the wave vector of the third.

    Parameters
    ----------
    resonances : Dataset
        Group ``/resonances`` of a wave store, or the result of `wavefield.resonances`.

    Returns
    -------
    Figure

    Notes
    -----
    Points: k1 and k2. Line: k3 of resonant quartets, the fourth wave being k4 = k1 + k2 - k3 (Phillips'
    figure of eight where k1 = k2). Grey: no more than chance exceeds in 5 % of the map, or no quartet.
    """
    figure, [[ax]] = panels(1, width=5.6, height=4.6)
    kx, ky = (resonances[f"map_k{axis}"].values / (2 * np.pi) for axis in "xy")
    values, level = resonances.map_coherence.values, float(resonances.map_level)
    _draw_above(ax, kx, ky, values, level, "squared coherence (1)")
    mismatch = resonances.map_mismatch.values
    if np.nanmin(mismatch, initial=0) < 0 < np.nanmax(mismatch, initial=0):
        ax.contour(kx, ky, mismatch, [0.0], colors="0.3", linewidths=1.0)
    pair = (resonances[f"map_pair_k{axis}"].values / (2 * np.pi) for axis in "xy")
    ax.plot(*pair, "o", color=LINES[0]["color"], markeredgecolor="white")
    share = float(np.mean(values[np.isfinite(values)] > level)) if np.isfinite(values).any() else 0.0
    title = f"{100 * share:.0f} % above the level of 5 %"
    ax.set(xlabel="k₃x / 2π (m⁻¹)", ylabel="k₃y / 2π (m⁻¹)", title=title, aspect="equal")
    return figure


def _draw_above(
    ax: Axes, x: np.ndarray, y: np.ndarray, values: np.ndarray, level: np.ndarray | float, label: str
) -> None:
    """Draw a coherence (y, x) where it is above its level of chance, grey elsewhere."""
    ax.set_facecolor("0.92")
    above = np.where(values > level, values, np.nan)
    draw_cells(ax, x, y, above, label, norm=Normalize(0, 1), cmap=POSITIVE, extend="neither")


def bicoherence_map(higher_order: xr.Dataset) -> Figure:
    """Bicoherence above the level of chance.

    Parameters
    ----------
    higher_order : Dataset
        Group ``/higher_order`` of a wave store.

    Returns
    -------
    Figure
    """
    names = [name for name in ("bicoherence", "tricoherence") if name in higher_order]
    figure, axes = panels(len(names))
    first, second = (higher_order[d].values / (2 * np.pi) for d in ("omega1", "omega2"))
    for ax, name in zip(axes[0], names, strict=True):
        values = higher_order[name].transpose("omega1", "omega2").values
        level = np.asarray(higher_order[f"{name}_level"].values, float)
        _draw_above(ax, second, first, values, level, f"{name} (1)")
        ax.set(xlabel="ω₂ / 2π (Hz)", ylabel="ω₁ / 2π (Hz)", title=f"{name}, grey: chance", aspect="equal")
    return figure
