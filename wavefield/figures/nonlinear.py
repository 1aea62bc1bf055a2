"""Waves that are not linear: free and bound ones, coherences of three and four waves."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from wavefield.figures.display import POSITIVE
from wavefield.figures.style import draw_cells, panels


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
