"""Camera pairs against one another: errors without any truth."""

from itertools import combinations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wavefield.figures.style import LINES, densities, panels, plain_axes


def _draw(axes: Axes, curves: dict[str, np.ndarray], unit: str, *, positive: bool = False) -> None:
    """Draw densities of several samples on one axis, their rms in the legend."""
    rms = {
        name: float(np.sqrt(np.nanmean(c**2))) if np.isfinite(c).any() else 0.0 for name, c in curves.items()
    }
    span = 5 * max([*rms.values(), 1e-12])
    bins = np.linspace(0 if positive else -span, span, 101)
    centres = (bins[1:] + bins[:-1]) / 2
    for style, (name, values) in zip(LINES[1:], curves.items(), strict=False):
        density = densities(values, bins)
        label = f"{name}, rms {rms[name]:.2g} {unit}"
        axes.semilogy(centres, np.where(density > 0, density, np.nan), label=label, **style)
    plain_axes(axes, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=1)


def pair_misfits(pairs: xr.Dataset) -> Figure:
    """Distributions of eps_y and of eps' of each pair of cameras on its own.

    Parameters
    ----------
    pairs : Dataset, (pair, time, y, x)
        eps_y (m) and eps_piv (px), as from `wavefield.report.pairs.measure_pairs`.

    Returns
    -------
    Figure

    Notes
    -----
    Counterpart of the paper's distributions of eps_Y for three pairs and of its PIV errors.
    """
    single = pairs.sel(pair=[p for p in pairs.pair.values if p != "all"])
    figure, axes = panels(2, height=4.6)
    found = {str(p): 1e3 * single.eps_y.sel(pair=p).values.astype(float) for p in single.pair.values}
    _draw(axes[0, 0], found, "mm")
    axes[0, 0].set(xlabel="eps_y (mm)", ylabel="probability density (mm⁻¹)")
    found = {str(p): single.eps_piv.sel(pair=p).values.astype(float) for p in single.pair.values}
    _draw(axes[0, 1], found, "px", positive=True)
    axes[0, 1].set(xlabel="eps' (px)", ylabel="probability density (px⁻¹)")
    return figure


def pair_differences(pairs: xr.Dataset, pixel: float) -> Figure:
    """Differences between pairs of cameras: of z, of dx, of dy, of dz, and of all together from each.

    Parameters
    ----------
    pairs : Dataset, (pair, time, y, x)
        z (m) and u, v, w (m s-1), as from `wavefield.report.pairs.measure_pairs`.
    pixel : float
        Size of a pixel on the water, m.

    Returns
    -------
    Figure

    Notes
    -----
    Counterpart of the paper's differences between the three pairs, and, where a pair is compared with all, of
    its recombination against the direct pair. The mean in time of each node is kept.
    """
    rate = float(pairs.attrs["frame_rate"])
    names = [str(p) for p in pairs.pair.values]
    single = [name for name in names if name != "all"]
    figure, axes = panels(2, 2, height=4.8)
    for ax, (name, label) in zip(axes.flat, {"z": "z", "u": "dx", "v": "dy", "w": "dz"}.items(), strict=True):
        field = pairs[name].astype(float) / (pixel if name == "z" else rate * pixel)
        curves = {
            f"{a} minus {b}": (field.sel(pair=a) - field.sel(pair=b)).values
            for a, b in combinations(single, 2)
        }
        if name == "z" and "all" in names:  # the direct pair is the one without the common camera
            direct = single[-1]
            curves[f"all minus {direct}"] = (field.sel(pair="all") - field.sel(pair=direct)).values
        _draw(ax, curves, "px")
        ax.set(xlabel=f"difference of {label} (px)", ylabel="probability density (px⁻¹)")
    return figure
