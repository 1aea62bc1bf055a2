"""Crests, increments, vortices, drift and energy."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from wavefield.figures.style import LINES, finish, panels


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
