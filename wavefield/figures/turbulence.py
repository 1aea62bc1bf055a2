"""Crests, increments, vortices, drift and energy."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from wavefield.figures.style import CYCLES, LINES, cycles, draw_curves, finish, panels


def crest_curves(crests: xr.Dataset) -> Figure:
    """Fraction of crests and troughs that exceed a level, with the laws of Rayleigh and of Tayfun.

    Parameters
    ----------
    crests : Dataset
        The result of `wavefield.crest_statistics`.

    Returns
    -------
    Figure
    """
    figure, [[ax]] = panels(1, width=5.6)
    level = crests.level.values
    for style, name in zip(LINES[1:], ("crest", "trough"), strict=False):
        part, std = crests[f"{name}_exceedance"].values, crests[f"{name}_exceedance_std"].values
        some = part > 0
        ax.semilogy(level[some], part[some], label=f"{name}s", **style)
        low = np.maximum(part - 2 * std, part / 20)
        ax.fill_between(level[some], low[some], (part + 2 * std)[some], color=style["color"], alpha=0.2)
    for dash, name in (("--", "rayleigh"), (":", "tayfun")):
        ax.semilogy(level, crests[name].values, color="0.35", linestyle=dash, label=name.capitalize())
    smallest = 0.3 / max(float(crests.waves), 10.0)
    finish(ax, "level (standard deviations)", "fraction beyond it", ylim=(smallest, 1.5))
    return figure


def flatness_curves(structure: xr.Dataset) -> Figure:
    """Second-order structure functions and flatness of increments, over the lag in time and space.

    Parameters
    ----------
    structure : Dataset
        The result of `wavefield.structure_functions`.

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
        for ax in (above, below):
            ax.xaxis.set_minor_formatter(NullFormatter())
        finish(above, "", "S₂, the mean squared increment")
        finish(below, f"lag ({unit})", "flatness S₄ / S₂²")
    return figure


def vortex_spectra(split: xr.Dataset) -> Figure:
    """Spectrum over k of the horizontal velocity along the wave vector and across it.

    Parameters
    ----------
    split : Dataset
        The result of `wavefield.waves_and_vortices`.

    Returns
    -------
    Figure
    """
    figure, [[ax]] = panels(1, width=5.6)
    step = float(split.omega[1] - split.omega[0])
    names = {"waves": "waves", "vortices": "vortices", "leak": "waves that the windows turn across"}
    over_k = {n: (split[f"E_{n}"].where(split.valid).sum("omega") * step).values for n in names}
    draw_curves(ax, cycles(split), {names[n]: E for n, E in over_k.items()}, LINES[1:], log="xy")
    ax.xaxis.set_minor_formatter(NullFormatter())
    part, std = (100 * float(split[name]) for name in ("vortical_fraction", "vortical_fraction_std"))
    title = f"vortices: ({part:.2g} ± {std:.1g}) % of the variance"
    finish(ax, CYCLES, "E(k) of (u, v) (m³ s⁻² rad⁻¹)", title=title)
    return figure


def path_map(paths: xr.Dataset, start: int = 0) -> Figure:
    """Paths of points of the surface water, each with its beginning.

    Parameters
    ----------
    paths : Dataset
        The result of `wavefield.surface_paths`.
    start : int
        Which of its starts.

    Returns
    -------
    Figure
    """
    figure, [[ax]] = panels(1, width=6.4, height=4.8)
    one = paths.isel(start=start)
    ax.plot(one.path_x.transpose("age", "path").values, one.path_y.transpose("age", "path").values, lw=0.8)
    ax.plot(one.path_x.isel(age=0).values, one.path_y.isel(age=0).values, "k.", markersize=3)
    drift = ", ".join(
        f"{a} {100 * float(paths[f'drift_{a}']):.2g} ± {100 * float(paths[f'drift_{a}_std']):.1g}"
        for a in "xy"
    )
    finish(ax, "x (m)", "y (m)", aspect="equal", title=f"drift: {drift} cm s⁻¹")
    return figure


def energy_bars(budget: xr.Dataset) -> Figure:
    """Terms of the energy budget in each band of frequency.

    Parameters
    ----------
    budget : Dataset
        The result of `wavefield.energy_budget`.

    Returns
    -------
    Figure
    """
    figure, [[ax]] = panels(1, width=6.4)
    names = ("growth", "divergence", "viscous", "unexplained")
    place = np.arange(budget.sizes["band"])
    for i, (style, name) in enumerate(zip(LINES[1:], names)):
        std = 2e3 * budget[f"{name}_std"].values if f"{name}_std" in budget else None
        at = place + 0.2 * (i - 1.5)
        ax.bar(at, 1e3 * budget[name].values, 0.18, yerr=std, color=style["color"], label=name, ecolor="0.4")
    ax.axhline(0, color="0.3", linewidth=0.8)
    ax.set_xticks(place, [f"{f:.3g}" for f in budget.band.values])
    finish(ax, "middle of the band (Hz)", "power (mW m⁻²)")
    return figure
