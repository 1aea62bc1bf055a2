"""Figures of coverage and faults of a cube, misfits, uncertainties, and distributions of its fields."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wavefield.figures.display import POSITIVE
from wavefield.figures.style import (
    LINES,
    draw_map,
    draw_positive_map,
    finish,
    map_panels,
    panels,
    positive,
)
from wavefield.variables import FrameStatus, Quality

_DISPLACEMENTS = {"u": "dx = u dt", "v": "dy = v dt", "w": "dz = w dt"}
_REASONS = {
    "measured": Quality.MEASURED,
    "filled from neighbours": Quality.FILLED,
    "rejected by correlation": Quality.REJECTED_CORRELATION,
    "rejected by eps": Quality.REJECTED_EPS,
    "rejected by neighbours": Quality.REJECTED_NEIGHBOURS,
    "beyond the range searched": Quality.REJECTED_RANGE,
}


def _quality_shares(quality: xr.DataArray, dims: tuple[str, ...]) -> xr.Dataset:
    """Return the fraction of values along `dims` for each kind in `_REASONS` (measured, filled, ...)."""
    return xr.Dataset(
        {name: ((quality & np.uint16(int(flag))) != 0).mean(dims) for name, flag in _REASONS.items()}
    )


def coverage_map(cube: xr.Dataset) -> Figure:
    """Draw maps of the fractions of time in which each node was measured and was filled from neighbours.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with quality.

    Returns
    -------
    Figure
    """
    shares = _quality_shares(cube.quality, ("time",)).compute()
    figure, axes = map_panels(cube.quality, 2)
    for ax, name in zip(axes[0], ("measured", "filled from neighbours"), strict=True):
        draw_map(ax, shares[name], "fraction of time (%)", 100, cmap=POSITIVE, scale=(0, 100), title=name)
    return figure


def fault_history(cube: xr.Dataset) -> Figure:
    """Draw over time the fractions of the visible nodes that were measured, filled and rejected.

    A second panel shows the status of each step: measured, failed, ...

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with quality and frame_status.

    Returns
    -------
    Figure
    """
    nothing = np.uint16(Quality.OUTSIDE | Quality.MASKED)  # cubes of early versions store 8 bits
    visible = (((cube.quality & nothing) == 0) & (cube.quality != 0)).mean(("y", "x")).compute()
    shares = _quality_shares(cube.quality, ("y", "x")).compute()
    figure, axes = panels(1, 2, width=10.4, height=2.3)
    top, bottom = axes[:, 0]
    for style, name in zip(LINES, shares.data_vars, strict=False):
        with np.errstate(divide="ignore", invalid="ignore"):
            top.plot(cube.time, 100 * shares[name] / visible.where(visible > 0), label=name, **style)
    finish(top, "", "fraction of nodes (%)", ylim=(-3, 103))
    bottom.plot(cube.time, cube.frame_status, drawstyle="steps-mid", **LINES[1])
    names = [status.name.lower().replace("_", " ") for status in FrameStatus]
    ticks: dict[str, Any] = {"yticks": list(FrameStatus), "yticklabels": names}
    finish(bottom, "time (s)", "", ylim=(-0.5, len(names) - 0.5), **ticks)
    return figure


def misfit_maps(cube: xr.Dataset) -> Figure:
    """Draw maps of the rms in time of the epipolar error eps_y and the misfit of displacements eps_piv.

    The misfit is the disagreement between the displacements that the cameras measure.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with eps_y (m) and eps_piv (px).

    Returns
    -------
    Figure
    """
    figure, axes = map_panels(cube.eps_y, 2)
    rms = ((cube[["eps_y", "eps_piv"]].astype(float) ** 2).mean("time") ** 0.5).compute()
    draw_positive_map(axes[0, 0], rms.eps_y, "rms eps_y (mm)", 1e3)
    draw_positive_map(axes[0, 1], rms.eps_piv, "rms eps' (px)", 1.0)
    return figure


def uncertainty_maps(cube: xr.Dataset) -> Figure:
    """Draw maps of the standard uncertainties of z, u, v and w: medians in time over at most 200 steps.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with z_std (m) and u_std, v_std, w_std (m s-1).

    Returns
    -------
    Figure
    """
    figure, axes = map_panels(cube.z_std, 2, 2)
    for ax, name in zip(axes.ravel(), ("z_std", "u_std", "v_std", "w_std"), strict=True):
        unit = "mm" if name == "z_std" else "mm s⁻¹"
        every = -(-cube.sizes["time"] // 200)  # 200 steps suffice for a median, and save memory
        median = cube[name].isel(time=slice(None, None, every)).load().median("time")
        draw_positive_map(ax, median, f"{name} ({unit})", 1e3)
    return figure


def _draw_densities(
    axes: Axes, curves: Mapping[str, np.ndarray], unit: str, xlabel: str, gaussian: bool = False
) -> None:
    """Draw the probability density of each array in `curves`, by name; values, of any shape, are in `unit`.
    With `gaussian`, add a Gaussian with the mean and standard deviation of the widest density."""
    finite = {name: np.asarray(values[np.isfinite(values)], float) for name, values in curves.items()}
    moments = {
        name: (float(v.std()), float(v.mean())) if v.size else (0.0, 0.0) for name, v in finite.items()
    }
    widest, centre = max(moments.values())
    span = 5 * (widest or 1.0)
    for style, (name, values) in zip(LINES[1:], finite.items(), strict=False):
        sigma, mean = moments[name]
        bins = np.linspace(mean - span, mean + span, 121)
        density = np.histogram(values, bins)[0] / (max(values.size, 1) * (bins[1] - bins[0]))
        middles = (bins[1:] + bins[:-1]) / 2
        axes.semilogy(middles, positive(density), label=f"{name}, σ = {sigma:.3g} {unit}", **style)
    if gaussian and widest > 0:
        s = np.linspace(-5, 5, 241)
        g = np.exp(-(s**2) / 2) / (widest * np.sqrt(2 * np.pi))
        axes.semilogy(centre + widest * s, g, color="0.45", linestyle=(0, (4, 2)), label="Gaussian")
        axes.set_ylim(3e-5 / widest, 1.2 / widest)
    axes.locator_params(axis="x", nbins=6)
    finish(axes, xlabel, f"probability density ({unit}⁻¹)")


def _displacements(cube: xr.Dataset, factor: float) -> dict[str, np.ndarray]:
    """Return the displacements between two frames, (time, y, x), in metres times `factor`.
    Their keys are labels such as "dx = u dt"."""
    rate = float(cube.attrs["frame_rate"])
    return {label: factor / rate * cube[name].values for name, label in _DISPLACEMENTS.items()}


def distributions(cube: xr.Dataset) -> Figure:
    """Draw the probability densities of z and of the displacements between two frames, with Gaussians.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with z (m) and u, v, w (m s-1) and the attribute frame_rate (Hz). Thin a long one in time
        first: all values are loaded.

    Returns
    -------
    Figure
    """
    figure, [[left, right]] = panels(2)
    _draw_densities(left, {"z": 100 * cube.z.values}, "cm", "z (cm)", gaussian=True)
    _draw_densities(right, _displacements(cube, 100), "cm", "displacement in one step (cm)", gaussian=True)
    return figure


def rest_distributions(rest: xr.Dataset) -> Figure:
    """Draw the probability densities of z and of the displacements between two frames for still water.

    A second curve is z minus its mean over time at each node. Aubourg et al. (2019) show the same figure.

    Parameters
    ----------
    rest : Dataset, (time, y, x)
        A cube of still water with z (m) and u, v, w (m s-1) and the attribute frame_rate (Hz).

    Returns
    -------
    Figure
    """
    figure, [[left, right]] = panels(2)
    z = 1e3 * rest.z
    _draw_densities(left, {"z": z.values, "z − ⟨z⟩": (z - z.mean("time")).values}, "mm", "z (mm)")
    _draw_densities(right, _displacements(rest, 1e3), "mm", "displacement in one step (mm)")
    return figure


def error_distributions(errors: xr.Dataset, pixel: float) -> Figure:
    """Draw the probability densities of the errors of z and of the displacements in a simulated experiment.

    Parameters
    ----------
    errors : Dataset, (time, y, x)
        Measured minus exact: z (m) and u, v, w (m s-1), with the attribute frame_rate (Hz).
    pixel : float
        Size of a pixel on the water, m.

    Returns
    -------
    Figure
    """
    figure, [[left, right]] = panels(2)
    scale = f"measured − exact (px; 1 px = {1e3 * pixel:.3g} mm on the water)"
    _draw_densities(left, {"z": errors.z.values / pixel}, "px", scale)
    _draw_densities(right, _displacements(errors, 1 / pixel), "px", "measured − exact (px)")
    return figure
