"""Figures of the surface and its velocity at one step."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from wavefield.figures.display import SIGNED, limit, thin
from wavefield.figures.style import draw_map, map_panels, moment_title, panels, round_down

MAX_POLYGONS = 70  # along each axis of the 3D view; more take seconds without a visible difference


def surface_3d(snapshot: xr.Dataset) -> Figure:
    """Draw the elevation in three dimensions, with exaggerated heights and the vertical velocity in colour.

    Parameters
    ----------
    snapshot : Dataset, (y, x)
        One step of a cube with z (m) and w (m s-1).

    Returns
    -------
    Figure
    """
    stride = {d: slice(None, None, -(-snapshot.sizes[d] // MAX_POLYGONS)) for d in ("y", "x")}
    part = snapshot[["z", "w"]].isel(stride).transpose("y", "x")
    z, w = 100 * part.z.values.astype(float), 100 * part.w.values.astype(float)
    figure, [[axes]] = panels(1, width=7.2, height=4.8, projection="3d")
    half = limit(w)
    colours = ScalarMappable(Normalize(-half, half), SIGNED)
    figure.colorbar(colours, ax=axes, label="w (cm s⁻¹)", shrink=0.6, pad=0.13, extend="both")
    x, y = np.meshgrid(part.x.values, part.y.values)
    faces = colours.to_rgba(w)
    faces[..., :3] *= _relief(z)[..., None]
    corners = np.stack([x, y, z], axis=-1)
    quads = np.stack([corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]], axis=2)
    quads = quads.reshape(-1, 4, 3)
    # matplotlib uses uninitialised memory for faces with fewer than four corners
    complete = np.isfinite(quads).all(axis=(1, 2))
    if complete.any():
        colour = faces[:-1, :-1].reshape(-1, 4)[complete]
        axes.add_collection3d(
            Poly3DCollection(quads[complete], facecolors=colour, linewidths=0, antialiaseds=False)
        )
    height = 1.6 * limit(z, 100)
    span = np.ptp(x), np.ptp(y)
    axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (cm)", title=moment_title(snapshot))
    axes.set(xlim=(x.min(), x.max()), ylim=(y.min(), y.max()), zlim=(-height, height))
    axes.set_box_aspect((span[0], span[1], 0.35 * max(span)), zoom=1.05)
    axes.view_init(elev=32, azim=-60)
    return figure


def _relief(z: np.ndarray) -> np.ndarray:
    """Return brightness factors from 0.72 to 1 for a surface z (y, x), as if light came from one side."""
    slope = np.nan_to_num(np.gradient(z, axis=1) - np.gradient(z, axis=0))
    return np.asarray(0.86 + 0.14 * np.clip(slope / limit(slope, 95), -1, 1))


def velocity_map(snapshot: xr.Dataset) -> Figure:
    """Draw a map of the vertical velocity, with arrows of the horizontal velocity.

    Parameters
    ----------
    snapshot : Dataset, (y, x)
        One step of a cube with u, v, w (m s-1).

    Returns
    -------
    Figure
    """
    figure, [[ax]] = map_panels(snapshot.w, 1, width=7.4)
    draw_map(ax, snapshot.w, "w (cm s⁻¹)", factor=100)
    ax.set_title(moment_title(snapshot), loc="left")
    some = thin(snapshot.sizes["x"], snapshot.sizes["y"])
    part = snapshot[["u", "v"]].isel(x=some, y=some).transpose("y", "x")
    u, v = 100 * part.u.values.astype(float), 100 * part.v.values.astype(float)
    fastest = limit(np.hypot(u, v), 98)
    spacing = some.step * float(np.mean(np.diff(snapshot.x.values)))
    scale: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": fastest / (1.4 * spacing)}
    arrows = ax.quiver(part.x.values, part.y.values, u, v, width=0.0028, color="black", **scale)
    key = round_down(fastest)
    ax.quiverkey(arrows, 0.86, 1.04, key, f"{key:g} cm s⁻¹", labelpos="E", coordinates="axes")
    return figure
