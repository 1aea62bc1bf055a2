"""Waves that are not linear: free and bound ones."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from wavefield.figures.style import LINES, panels, plain_axes


def bound_spectra(bound: xr.Dataset) -> Figure:
    """Spectra of the free and of the bound waves.

    Parameters
    ----------
    bound : Dataset
        Group ``/bound`` of a wave store, or what `wavefield.free_and_bound` gives.

    Returns
    -------
    Figure
    """
    figure, axes = panels(1, width=7.2, height=4.4)
    ax = axes[0, 0]
    hertz = bound.omega.values / (2 * np.pi)
    names = {
        "E_free": "free waves",
        "E_bound": "bound waves",
        "E_harmonic": "of these on the second harmonic",
    }
    top = float(bound.E_free.max())
    for (name, label), line in zip(names.items(), LINES):
        values = bound[name].values
        ax.semilogy(hertz, np.where(values > 1e-9 * top, values, np.nan), label=label, **line)
    fraction, std = 100 * float(bound.bound_fraction), 100 * float(bound.bound_fraction_std)
    ax.set(
        xlabel="ω / 2π (Hz)",
        ylabel="E$^z$(ω) (m² s rad⁻¹)",
        ylim=(1e-7 * top, 3 * top),
        title=f"bound: {fraction:.2g} ± {std:.1g} % of the variance",
    )
    plain_axes(ax)
    return figure


def resonance_map(resonances: xr.Dataset) -> Figure:
    """The significant quartets over the k plane, and the mean coherence on resonance and off it.

    Parameters
    ----------
    resonances : Dataset
        Group ``/resonances`` of a wave store, or what `wavefield.resonances` gives.

    Returns
    -------
    Figure

    Notes
    -----
    Left: k1 and k2 as points, k3 and k4 as circles, joined by the parallelogram that they span; the ten least
    probable ones, each in a colour of its own. Right: squared coherence of all quartets less that of
    surrogates against the frequency by which the fourth wave lies off the dispersion relation.
    """
    figure, axes = panels(2, height=4.4)
    left, right = axes[0]
    kx, ky = (resonances[f"quartet_k{axis}"].values / (2 * np.pi) for axis in "xy")
    chosen = np.flatnonzero(resonances.quartet_significant.values)[:10]
    for style, i in zip(LINES * 2, chosen):
        left.plot(kx[i, [0, 2, 1, 3, 0]], ky[i, [0, 2, 1, 3, 0]], color=style["color"], linewidth=0.8)
        left.plot(kx[i, :2], ky[i, :2], "o", color=style["color"])
        left.plot(kx[i, 2:], ky[i, 2:], "o", color=style["color"], markerfacecolor="white")
    if chosen.size:
        left.plot([], [], "o", color="0.3", label="k₁, k₂")
        left.plot([], [], "o", color="0.3", markerfacecolor="white", label="k₃, k₄")
    half = 1.1 * max(float(np.abs(kx).max(initial=0)), float(np.abs(ky).max(initial=0)), 1.0)
    tests = int(resonances.quartet_tests)
    left.set(
        xlabel="kx / 2π (m⁻¹)",
        ylabel="ky / 2π (m⁻¹)",
        xlim=(-half, half),
        ylim=(-half, half),
        aspect="equal",
        title=f"{int(resonances.quartet_significant.sum())} significant of {tests} quartets",
    )
    plain_axes(left, loc="upper right")
    hertz = resonances.mismatch.values / (2 * np.pi)
    excess, std = resonances.coherence_excess.values, resonances.coherence_excess_std.values
    right.errorbar(hertz, 1e3 * excess, 2e3 * std, fmt="o-", color="#0072B2", capsize=3)
    right.axhline(0.0, color="0.5", linewidth=0.8)
    right.set(xlabel="frequency off resonance (Hz)", ylabel="10³ (mean γ² − surrogates)")
    plain_axes(right)
    return figure
