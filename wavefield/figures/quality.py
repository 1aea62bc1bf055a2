"""Coverage, faults, misfits and uncertainties of a measurement."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from wavefield.figures.display import POSITIVE
from wavefield.figures.style import (
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

_REASONS = {
    "measured": Quality.MEASURED,
    "filled from neighbours": Quality.FILLED,
    "rejected by correlation": Quality.REJECTED_CORRELATION,
    "rejected by eps": Quality.REJECTED_EPS,
    "rejected by neighbours": Quality.REJECTED_NEIGHBOURS,
    "beyond the range searched": Quality.REJECTED_RANGE,
}


def quality_shares(quality: xr.DataArray, dims: tuple[str, ...]) -> xr.Dataset:
    """Share of values with each mark.

    Parameters
    ----------
    quality : DataArray, (time, y, x), int
        The cube's bit mask.
    dims : tuple of str
        Dimensions to average over.

    Returns
    -------
    Dataset
        One variable in [0, 1] for each of measured, filled and the rejections; nodes outside the field of
        view, and masked ones, count as zero.
    """
    return xr.Dataset(
        {name: ((quality & np.uint16(int(flag))) != 0).mean(dims) for name, flag in _REASONS.items()}
    )


def coverage_map(cube: xr.Dataset) -> Figure:
    """Share of time in which each node was measured, and in which it was filled.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with quality.

    Returns
    -------
    Figure
    """
    shares = quality_shares(cube.quality, ("time",)).compute()
    figure, axes = map_panels(cube.quality, 2)
    for ax, name in zip(axes[0], ("measured", "filled from neighbours"), strict=True):
        draw_map(
            ax, shares[name], "fraction of time (%)", factor=100, cmap=POSITIVE, scale=(0, 100), title=name
        )
    return figure


def fault_history(cube: xr.Dataset) -> Figure:
    """Course of the measured and rejected shares of the nodes in view, and the status of the steps.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with quality and frame_status.

    Returns
    -------
    Figure
    """
    nothing = np.uint16(Quality.OUTSIDE | Quality.MASKED)  # older cubes hold 8 bits
    visible = (((cube.quality & nothing) == 0) & (cube.quality != 0)).mean(("y", "x")).compute()
    shares = quality_shares(cube.quality, ("y", "x")).compute()
    figure, axes = panels(1, 2, width=8.6, height=2.3)
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
    """Root mean square in time of the stereo mismatch eps_y and of the PIV misfit eps'.

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


def misfit_distributions(cube: xr.Dataset) -> Figure:
    """Distributions of eps_y and of eps'.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with eps_y (m) and eps_piv (px); a long one may be thinned in time before.

    Returns
    -------
    Figure

    Notes
    -----
    Counterparts of the paper's distributions of its errors eps_Y and eps'.
    """
    figure, axes = panels(2)
    for ax, values, lowest, label, unit in (
        (axes[0, 0], 1e3 * cube.eps_y.values.astype(float), -6, "eps_y", "mm"),
        (axes[0, 1], cube.eps_piv.values.astype(float), 0, "eps'", "px"),
    ):
        rms = float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else 1.0
        bins = np.linspace(lowest * rms, 6 * rms, 121 if lowest else 101)
        centres = (bins[1:] + bins[:-1]) / 2
        ax.semilogy(centres, positive(densities(values, bins)), label=f"rms {rms:.3g} {unit}", **LINES[1])
        if lowest:
            gaussian = np.exp(-((centres / rms) ** 2) / 2) / (rms * np.sqrt(2 * np.pi))
            ax.semilogy(centres, gaussian, label="Gaussian of that rms", **LINES[2])
            ax.set_ylim(1e-5 / rms, 1 / rms)
        finish(ax, f"{label} ({unit})", f"probability density ({unit}⁻¹)")
    return figure


def uncertainty_maps(cube: xr.Dataset) -> Figure:
    """Median in time of the standard uncertainties of z, u, v and w.

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
    stride = -(-field.sizes["time"] // 200)  # 200 steps give the median to a few percent
    part = field.isel(time=slice(None, None, stride)).load()
    values = np.ma.filled(
        np.ma.median(np.ma.masked_invalid(part.values), axis=part.get_axis_num("time")), np.nan
    )
    return part.isel(time=0, drop=True).copy(data=values)
