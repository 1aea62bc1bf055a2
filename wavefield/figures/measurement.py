"""Coverage and faults of a cube; maps of misfits and uncertainties; distributions of fields and errors."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wavefield.figures.display import POSITIVE
from wavefield.figures.style import (
    ABOVE,
    LINES,
    RIGHT,
    densities,
    draw_map,
    draw_positive_map,
    finish,
    map_panels,
    panels,
    plain_axes,
    positive,
    rms_in_time,
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
    """Return the fraction of values that have each quality bit of `_REASONS`, averaged over `dims`."""
    return xr.Dataset(
        {name: ((quality & np.uint16(int(flag))) != 0).mean(dims) for name, flag in _REASONS.items()}
    )


def coverage_map(cube: xr.Dataset) -> Figure:
    """Draw maps of the fraction of time in which each node was measured, and in which it was interpolated.

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
        draw_map(
            ax, shares[name], "fraction of time (%)", factor=100, cmap=POSITIVE, scale=(0, 100), title=name
        )
    return figure


def fault_history(cube: xr.Dataset) -> Figure:
    """Draw over time which fraction of the visible nodes was measured, filled or rejected.

    A second panel shows the status of each step.

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
    top.set(ylabel="fraction of nodes (%)", ylim=(-3, 103))
    plain_axes(top, **RIGHT)
    bottom.plot(cube.time, cube.frame_status, drawstyle="steps-mid", **LINES[1])
    names = [status.name.lower().replace("_", " ") for status in FrameStatus]
    bottom.set(yticks=list(FrameStatus), yticklabels=names, xlabel="time (s)", ylim=(-0.5, len(names) - 0.5))
    plain_axes(bottom)
    return figure


def misfit_maps(cube: xr.Dataset) -> Figure:
    """Draw maps of the rms in time of the epipolar error eps_y and of eps', the misfit of displacements.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with eps_y (m) and eps_piv (px).

    Returns
    -------
    Figure
    """
    figure, axes = map_panels(cube.eps_y, 2)
    draw_positive_map(axes[0, 0], rms_in_time(cube.eps_y), "rms eps_y (mm)", 1e3)
    draw_positive_map(axes[0, 1], rms_in_time(cube.eps_piv), "rms eps' (px)")
    return figure


def uncertainty_maps(cube: xr.Dataset) -> Figure:
    """Draw maps of the median in time of the standard uncertainties of z, u, v and w.

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
        draw_positive_map(ax, _median_in_time(cube[name]), f"{name} ({unit})", 1e3, percent=98)
    return figure


def _median_in_time(field: xr.DataArray) -> xr.DataArray:
    """Return the median over time, (y, x), of at most 200 evenly spaced steps, to save memory."""
    stride = -(-field.sizes["time"] // 200)
    part = field.isel(time=slice(None, None, stride)).load()
    values = np.ma.filled(
        np.ma.median(np.ma.masked_invalid(part.values), axis=part.get_axis_num("time")), np.nan
    )
    return part.isel(time=0, drop=True).copy(data=values)


def _draw_density(
    axes: Axes, values: np.ndarray, unit: str, name: str, style: dict[str, object], span: float
) -> float:
    """Draw the probability density of values (any shape), and return their standard deviation.
    The curve covers values within `span` of the mean. `unit` and `name` go into the legend, `style` holds the
    settings of the line."""
    finite = values[np.isfinite(values)]
    sigma, mean = (float(finite.std()), float(finite.mean())) if finite.size else (0.0, 0.0)
    bins = np.linspace(mean - span, mean + span, 121) if span else np.linspace(-1, 1, 121)
    centres, density = (bins[1:] + bins[:-1]) / 2, positive(densities(finite, bins))
    axes.semilogy(centres, density, label=f"{name}, σ = {sigma:.3g} {unit}", **style)
    axes.locator_params(axis="x", nbins=6)
    return sigma


def _draw_gaussian(axes: Axes, sigma: float, mean: float, span: float) -> None:
    if sigma > 0:
        s = np.linspace(mean - span, mean + span, 241)
        g = np.exp(-(((s - mean) / sigma) ** 2) / 2) / (sigma * np.sqrt(2 * np.pi))
        axes.semilogy(s, g, color="0.45", linestyle=(0, (4, 2)), linewidth=1.1, label="Gaussian")
        axes.set_ylim(3e-5 / sigma, 1.2 / sigma)


def _displacements(cube: xr.Dataset, factor: float) -> dict[str, np.ndarray]:
    """Return the displacements in one step, (time, y, x), m, times a factor, by the keys "u", "v" and "w".
    `cube` has the velocities u, v, w in m/s and the attribute frame_rate, Hz."""
    rate = float(cube.attrs["frame_rate"])
    return {name: factor / rate * cube[name].values.astype(float) for name in _DISPLACEMENTS}


def _largest_std(fields: dict[str, np.ndarray]) -> float:
    """Return the largest standard deviation of the fields; 1 if it is zero or no field has values."""
    return max((float(np.nanstd(f)) for f in fields.values() if np.isfinite(f).any()), default=0.0) or 1.0


def distributions(cube: xr.Dataset) -> Figure:
    """Draw the probability densities of z and of the displacements in one step, next to Gaussians.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with z (m) and u, v, w (m s-1) and the attribute frame_rate (Hz). Thin a long one in time
        first: all values are loaded.

    Returns
    -------
    Figure

    Notes
    -----
    Corresponds to the distributions of z, dx, dy and dz in Aubourg et al. (2019).
    """
    figure, [[left, right]] = panels(2)
    z = 100 * cube.z.values.astype(float)
    span = 5 * float(np.nanstd(z)) if np.isfinite(z).any() else 1.0
    sigma = _draw_density(left, z, "cm", "z", LINES[1], span)
    _draw_gaussian(left, sigma, float(np.nanmean(z)) if sigma else 0.0, span)
    finish(left, "z (cm)", "probability density (cm⁻¹)", ABOVE)
    fields = _displacements(cube, 100)
    widest = _largest_std(fields)
    for style, (name, label) in zip(LINES[1:], _DISPLACEMENTS.items(), strict=False):
        _draw_density(right, fields[name], "cm", label, style, 5 * widest)
    _draw_gaussian(right, widest, 0.0, 5 * widest)
    finish(right, "displacement in one step (cm)", "probability density (cm⁻¹)", ABOVE)
    return figure


def rest_distributions(rest: xr.Dataset, level: float = 0.0) -> Figure:
    """Draw the probability densities of z and of the displacements in one step for still water.

    Parameters
    ----------
    rest : Dataset, (time, y, x)
        A cube of still water with z (m) and u, v, w (m s-1) and the attribute frame_rate (Hz).
    level : float, default 0
        Elevation of the still water (z_rest), m.

    Returns
    -------
    Figure

    Notes
    -----
    Corresponds to the figure of water at rest in Aubourg et al. (2019): z - z_rest, the same minus the mean
    over time at each node, and dx, dy, dz.
    """
    figure, [[left, right]] = panels(2, height=4.6)
    z = 1e3 * (rest.z.values.astype(float) - level)
    measured = np.isfinite(z).sum(axis=0)
    centred = z - np.nansum(z, axis=0) / np.maximum(measured, 1)
    span = (5 * float(np.sqrt(np.nanmean(z**2))) if measured.any() else 0.0) or 1.0
    _draw_density(left, z, "mm", "z − z_rest", LINES[1], span)
    _draw_density(left, centred, "mm", "z − ⟨z⟩ − z_rest", LINES[2], span)
    finish(left, "z (mm)", "probability density (mm⁻¹)", ABOVE | {"ncols": 1})
    fields = _displacements(rest, 1e3)
    widest = _largest_std(fields)
    for style, (name, values) in zip(LINES[1:], fields.items(), strict=False):
        _draw_density(right, values, "mm", _DISPLACEMENTS[name][:2], style, 5 * widest)
    finish(right, "displacement in one step (mm)", "probability density (mm⁻¹)", ABOVE | {"ncols": 1})
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

    Notes
    -----
    Corresponds to the tests with synthetic images and with water at rest in Aubourg et al. (2019).
    """
    figure, axes = panels(2)
    moved = {_DISPLACEMENTS[name]: values for name, values in _displacements(errors, 1 / pixel).items()}
    scale = f" (px; 1 px = {1e3 * pixel:.3g} mm on the water)", " (px)"
    for ax, fields, unit in zip(axes[0], ({"z": errors.z.values / pixel}, moved), scale, strict=True):
        span = 6 * max(float(np.nanstd(e)) for e in fields.values())
        for style, (label, error) in zip(LINES[1:], fields.items(), strict=False):
            _draw_density(ax, error.astype(float), "px", label, style, span)
        finish(ax, f"measured − exact{unit}", "probability density (px⁻¹)", ABOVE)
    return figure
