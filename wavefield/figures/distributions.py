"""Distributions of the elevation and of the displacements, and of their errors where the truth is known."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wavefield.figures.style import (
    LINES,
    POSITIVE,
    densities,
    draw_map,
    limit,
    map_panels,
    panels,
    plain_axes,
)

_COMPONENTS = {"u": "dx = u dt", "v": "dy = v dt", "w": "dz = w dt"}


def draw_density(
    axes: Axes, values: np.ndarray, unit: str, named: str, style: dict[str, Any], span: float
) -> float:
    """Draw the density of values about their mean."""
    finite = values[np.isfinite(values)]
    sigma = float(finite.std()) if finite.size else 0.0
    mean = float(finite.mean()) if finite.size else 0.0
    bins = np.linspace(mean - span, mean + span, 121) if span else np.linspace(-1, 1, 121)
    density = densities(finite, bins)
    centres = (bins[1:] + bins[:-1]) / 2
    axes.semilogy(
        centres, np.where(density > 0, density, np.nan), label=f"{named}, σ = {sigma:.3g} {unit}", **style
    )
    return sigma


def _draw_gaussian(axes: Axes, sigma: float, mean: float, span: float) -> None:
    if sigma > 0:
        s = np.linspace(mean - span, mean + span, 241)
        g = np.exp(-(((s - mean) / sigma) ** 2) / 2) / (sigma * np.sqrt(2 * np.pi))
        axes.semilogy(s, g, color="0.45", linestyle=(0, (4, 2)), linewidth=1.1, label="Gaussian")
        axes.set_ylim(3e-5 / sigma, 1.2 / sigma)


def distributions(cube: xr.Dataset) -> Figure:
    """Densities of z and of the displacements in one step, with the Gaussian of the same spread.

    Parameters
    ----------
    cube : Dataset, (time, y, x)
        A cube with z (m) and u, v, w (m s-1) and the attribute frame_rate (Hz); a long one may be thinned in
        time before.

    Returns
    -------
    Figure

    Notes
    -----
    Counterpart of the paper's distributions of z, dx, dy and dz.
    """
    rate = float(cube.attrs["frame_rate"])
    figure, axes = panels(2)
    z = 100 * cube.z.values.astype(float)
    span = 5 * float(np.nanstd(z)) if np.isfinite(z).any() else 1.0
    sigma = draw_density(axes[0, 0], z, "cm", "z", LINES[1], span)
    _draw_gaussian(axes[0, 0], sigma, float(np.nanmean(z)) if sigma else 0.0, span)
    axes[0, 0].set(xlabel="z (cm)", ylabel="probability density (cm⁻¹)")
    moves = {name: 100 / rate * cube[name].values.astype(float) for name in _COMPONENTS}
    widest = max((float(np.nanstd(m)) for m in moves.values() if np.isfinite(m).any()), default=1.0)
    for style, (name, label) in zip(LINES[1:], _COMPONENTS.items(), strict=False):
        draw_density(axes[0, 1], moves[name], "cm", label, style, 5 * widest)
    _draw_gaussian(axes[0, 1], widest, 0.0, 5 * widest)
    axes[0, 1].set(xlabel="displacement in one step (cm)", ylabel="probability density (cm⁻¹)")
    for ax in axes[0]:
        plain_axes(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure


def error_distributions(errors: xr.Dataset, pixel: float) -> Figure:
    """Densities of the errors of z and of the displacements against the truth.

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
    Counterpart of the paper's test on synthetic images and of its test with water at rest.
    """
    rate = float(errors.attrs["frame_rate"])
    figure, axes = panels(2)
    pieces: tuple[Mapping[str, np.ndarray], ...] = (
        {"z": errors.z.values / pixel},
        {label: errors[name].values / (rate * pixel) for name, label in _COMPONENTS.items()},
    )
    for ax, piece in zip(axes[0], pieces, strict=True):
        span = 6 * max(float(np.nanstd(e)) for e in piece.values())
        for style, (label, error) in zip(LINES[1:], piece.items(), strict=False):
            draw_density(ax, error.astype(float), "px", label, style, span)
        ax.set(xlabel="measured − exact (px)", ylabel="probability density (px⁻¹)")
        plain_axes(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    axes[0, 0].set_xlabel(f"measured − exact (px; 1 px = {1e3 * pixel:.3g} mm on the water)")
    return figure


def error_maps(errors: xr.Dataset, pixel: float) -> Figure:
    """Root mean square in time of the errors against the truth, as maps.

    Parameters
    ----------
    errors : Dataset, (time, y, x)
        Measured minus exact: z (m) and w (m s-1), with the attribute frame_rate (Hz).
    pixel : float
        Size of a pixel on the water, m.

    Returns
    -------
    Figure
    """
    rate = float(errors.attrs["frame_rate"])
    figure, axes = map_panels(errors.z, 2)
    for ax, name, scale, label in zip(
        axes[0], ("z", "w"), (1 / pixel, 1 / (rate * pixel)), ("z", "dz = w dt"), strict=True
    ):
        rms = (errors[name].astype(float) ** 2).mean("time") ** 0.5
        top = scale * limit(rms, 99)
        draw_map(ax, rms, f"rms error of {label} (px)", factor=scale, cmap=POSITIVE, scale=(0, top))
    return figure
