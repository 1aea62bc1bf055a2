"""Figures of the paper: water at rest, vorticity, coherence of wave vectors."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from wavefield.figures.distributions import draw_density
from wavefield.figures.style import (
    LINES,
    draw_map,
    edges,
    limit,
    map_panels,
    moment_title,
    panels,
    plain_axes,
)


def rest_distributions(rest: xr.Dataset, level: float = 0.0) -> Figure:
    """Densities of z and of the displacements over water at rest.

    Parameters
    ----------
    rest : Dataset, (time, y, x)
        A cube of water at rest with z (m) and u, v, w (m s-1) and the attribute frame_rate (Hz).
    level : float
        Level of the water, m.

    Returns
    -------
    Figure

    Notes
    -----
    Counterpart of the paper's figure at rest: z - z_rest with and without each node's mean over time, and
    dx, dy, dz.
    """
    rate = float(rest.attrs["frame_rate"])
    figure, axes = panels(2, height=4.6)
    z = 1e3 * (rest.z.values.astype(float) - level)
    seen = np.isfinite(z).sum(axis=0)  # some nodes never: their mean is none, and no warning
    centred = z - np.nansum(z, axis=0) / np.maximum(seen, 1)
    span = (5 * float(np.sqrt(np.nanmean(z**2))) if seen.any() else 0.0) or 1.0
    draw_density(axes[0, 0], z, "mm", "z − z_rest", LINES[1], span)
    draw_density(axes[0, 0], centred, "mm", "z − ⟨z⟩ − z_rest", LINES[2], span)
    axes[0, 0].set(xlabel="z (mm)", ylabel="probability density (mm⁻¹)")
    moves = {n: 1e3 / rate * rest[n].values.astype(float) for n in ("u", "v", "w")}
    widest = max((float(np.nanstd(m)) for m in moves.values() if np.isfinite(m).any()), default=0.0) or 1.0
    for style, (name, values) in zip(LINES[1:], moves.items()):
        label = {"u": "dx", "v": "dy", "w": "dz"}[name]
        draw_density(axes[0, 1], values, "mm", label, style, 5 * widest)
    axes[0, 1].set(xlabel="displacement in one step (mm)", ylabel="probability density (mm⁻¹)")
    for ax in axes[0]:
        plain_axes(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=1)
    return figure


def vorticity_map(terms: xr.Dataset) -> Figure:
    """Vertical vorticity and divergence of the surface water at one moment.

    Parameters
    ----------
    terms : Dataset, (y, x)
        One step of what `wavefield.kinematics` gives: vorticity and divergence, s-1.

    Returns
    -------
    Figure
    """
    figure, axes = map_panels(terms.vorticity, 2)
    half = max(limit(terms.vorticity), limit(terms.divergence))
    for ax, name in zip(axes[0], ("vorticity", "divergence")):
        title = f"{name}, {moment_title(terms)}"
        draw_map(ax, terms[name], f"{name} (s⁻¹)", scale=(-half, half), title=title)
    return figure


def plane_coherence_maps(plane: xr.Dataset) -> Figure:
    """Coherence with the sum at each wave vector, and the three curves averaged after the ratio.

    Parameters
    ----------
    plane : Dataset
        As `wavefield.waves.plane_coherence` gives it.

    Returns
    -------
    Figure
    """
    figure, axes = panels(2, height=4.4)
    left, right = axes[0]
    mesh = left.pcolormesh(
        edges(plane.kx.values / (2 * np.pi)),
        edges(plane.ky.values / (2 * np.pi)),
        plane.plane_C_tot.values,
        vmin=0,
        vmax=1,
        cmap="cividis",
        rasterized=True,
    )
    figure.colorbar(mesh, ax=left, label="|C(k)| of z_t with w − u·∇z")
    left.set(xlabel="kx / 2π (m⁻¹)", ylabel="ky / 2π (m⁻¹)", aspect="equal")
    labels = {"w": "z_t with w", "nl": "z_t with −u·∇z", "tot": "z_t with w − u·∇z"}
    for style, (name, label) in zip(LINES, labels.items()):
        right.plot(plane.k.values / (2 * np.pi), plane[f"mean_C_{name}"].values, label=label, **style)
    right.set(xlabel="k / 2π (m⁻¹)", ylabel="|C|, averaged after the ratio", ylim=(0, 1.1))
    plain_axes(right)
    return figure
