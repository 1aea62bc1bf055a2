"""Crests, increments, vortices, drift and energy: what `wavefield.crest_statistics` and its kin give."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from wavefield.figures.style import LINES, panels, plain_axes


def crest_curves(crests: xr.Dataset) -> Figure:
    """How many crests and troughs exceed a level, beside the laws of Rayleigh and of Tayfun.

    Parameters
    ----------
    crests : Dataset
        What `wavefield.crest_statistics` gives.

    Returns
    -------
    Figure
    """
    figure, axes = panels(1, width=5.6)
    ax = axes[0, 0]
    level = crests.level.values
    for style, name in zip(LINES[1:], ("crest", "trough")):
        part, std = crests[f"{name}_exceedance"].values, crests[f"{name}_exceedance_std"].values
        seen = part > 0
        ax.semilogy(level[seen], part[seen], label=f"{name}s", **style)
        low = np.maximum(part - 2 * std, part / 20)
        ax.fill_between(level[seen], low[seen], (part + 2 * std)[seen], color=style["color"], alpha=0.2)
    for dash, name in zip(("--", ":"), ("rayleigh", "tayfun")):
        ax.semilogy(level, crests[name].values, color="0.35", linestyle=dash, label=name.capitalize())
    smallest = 0.3 / max(float(crests.waves), 10.0)
    ax.set(xlabel="level (standard deviations)", ylabel="fraction beyond it", ylim=(smallest, 1.5))
    plain_axes(ax)
    return figure


def flatness_curves(structure: xr.Dataset) -> Figure:
    """Second-order structure functions and flatness of increments, over the lag in time and space.

    Parameters
    ----------
    structure : Dataset
        What `wavefield.structure_functions` gives.

    Returns
    -------
    Figure
    """
    figure, axes = panels(2, rows=2, height=3.4)
    for column, (unit, names) in enumerate((("s", ("time",)), ("m", ("x", "y")))):
        above, below = axes[0, column], axes[1, column]
        for style, name in zip(LINES[1:], names):
            lag = structure[f"lag_{name}"].values
            second = structure[f"structure_{name}"].sel(order=2).values
            above.loglog(lag, second, label=f"along {name}", **style)
            flat, std = structure[f"flatness_{name}"].values, structure[f"flatness_{name}_std"].values
            below.semilogx(lag, flat, label=f"along {name}", **style)
            below.fill_between(lag, flat - 2 * std, flat + 2 * std, color=style["color"], alpha=0.2)
        below.axhline(3, color="0.35", linestyle="--", label="Gaussian field")
        above.set(ylabel="S₂, the mean squared increment")
        below.set(xlabel=f"lag ({unit})", ylabel="flatness S₄ / S₂²")
        for ax in (above, below):
            ax.xaxis.set_minor_formatter(NullFormatter())
        plain_axes(above)
        plain_axes(below)
    return figure


def vortex_spectra(split: xr.Dataset) -> Figure:
    """Spectrum over k of the horizontal velocity along the wave vector and across it.

    Parameters
    ----------
    split : Dataset
        What `wavefield.waves_and_vortices` gives.

    Returns
    -------
    Figure
    """
    figure, axes = panels(1, width=5.6)
    ax = axes[0, 0]
    step = float(split.omega[1] - split.omega[0])
    names = {"waves": "waves", "vortices": "vortices", "leak": "waves that the windows turn across"}
    for style, (name, label) in zip(LINES[1:], names.items()):
        energy = (split[f"E_{name}"].where(split.valid).sum("omega") * step).values
        ax.loglog(split.k.values / (2 * np.pi), np.where(energy > 0, energy, np.nan), label=label, **style)
    part, std = (100 * float(split[name]) for name in ("vortical_fraction", "vortical_fraction_std"))
    title = f"vortices: ({part:.2g} ± {std:.1g}) % of the variance"
    ax.set(xlabel="k / 2π (m⁻¹)", ylabel="E(k) of (u, v) (m³ s⁻² rad⁻¹)", title=title)
    ax.xaxis.set_minor_formatter(NullFormatter())
    plain_axes(ax)
    return figure


def path_map(paths: xr.Dataset, start: int = 0) -> Figure:
    """Paths of points of the surface water, each with its beginning.

    Parameters
    ----------
    paths : Dataset
        What `wavefield.surface_paths` gives.
    start : int
        Which of its starts.

    Returns
    -------
    Figure
    """
    figure, axes = panels(1, width=6.4, height=4.8)
    ax = axes[0, 0]
    one = paths.isel(start=start)
    ax.plot(one.path_x.transpose("age", "path").values, one.path_y.transpose("age", "path").values, lw=0.8)
    ax.plot(one.path_x.isel(age=0).values, one.path_y.isel(age=0).values, "k.", markersize=3)
    drift = ", ".join(
        f"{a} {100 * float(paths[f'drift_{a}']):.2g} ± {100 * float(paths[f'drift_{a}_std']):.1g}"
        for a in "xy"
    )
    ax.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title=f"drift: {drift} cm s⁻¹")
    plain_axes(ax)
    return figure


def energy_bars(budget: xr.Dataset) -> Figure:
    """Terms of the energy budget in each band of frequency.

    Parameters
    ----------
    budget : Dataset
        What `wavefield.energy_budget` gives.

    Returns
    -------
    Figure
    """
    figure, axes = panels(1, width=6.4)
    ax = axes[0, 0]
    names = ("growth", "divergence", "viscous", "unexplained")
    place = np.arange(budget.sizes["band"])
    for i, (style, name) in enumerate(zip(LINES[1:], names)):
        std = 2e3 * budget[f"{name}_std"].values if f"{name}_std" in budget else None
        at = place + 0.2 * (i - 1.5)
        ax.bar(at, 1e3 * budget[name].values, 0.18, yerr=std, color=style["color"], label=name, ecolor="0.4")
    ax.axhline(0, color="0.3", linewidth=0.8)
    ax.set_xticks(place, [f"{f:.3g}" for f in budget.band.values])
    ax.set(xlabel="middle of the band (Hz)", ylabel="power (mW m⁻²)")
    plain_axes(ax)
    return figure
