"""Current by depth, and crests near breaking."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from wavefield.figures.style import LINES, RIGHT, draw_map, finish, map_panels, moment_title, panels


def current_profile(shear: xr.Dataset) -> Figure:
    """Current by depth, and the Doppler velocity of each band of waves at the depth 1 / 2k.

    Parameters
    ----------
    shear : Dataset
        Group ``/shear`` of a wave store, or the result of `wavefield.current_by_depth`.

    Returns
    -------
    Figure
    """
    figure, [[ax]] = panels(1, width=5.6, height=4.6)
    centimetres = 100 * shear.z.values
    for style, name in zip(LINES[1:], "xy"):
        speed, std = 100 * shear[f"current_{name}"].values, 100 * shear[f"current_{name}_std"].values
        ax.plot(speed, centimetres, label=f"current along {name}", **style)
        ax.fill_betweenx(centimetres, speed - 2 * std, speed + 2 * std, color=style["color"], alpha=0.2)
        doppler, std = 100 * shear[f"doppler_{name}"].values, 100 * shear[f"doppler_{name}_std"].values
        dots = {"fmt": "o", "markersize": 4, "color": style["color"]}
        depth, label = -100 * shear.effective_depth.values, f"Doppler velocity along {name}"
        ax.errorbar(doppler, depth, xerr=2 * std, label=label, **dots)
    finish(ax, "velocity (cm s⁻¹)", "z (cm)", RIGHT)
    return figure


def breaking_map(snapshot: xr.Dataset) -> Figure:
    """Elevation with the crests, coloured by B = u / c.

    Parameters
    ----------
    snapshot : Dataset, (y, x)
        One step of a cube with z (m), and B of `wavefield.breaking`.

    Returns
    -------
    Figure
    """
    figure, [[ax]] = map_panels(snapshot.z, 1, width=7.4)
    draw_map(ax, snapshot.z, "z (cm)", factor=100, cmap="Greys_r", title=moment_title(snapshot))
    B = snapshot.B.values
    rows, columns = np.nonzero(np.isfinite(B))
    x, y = snapshot.x.values[columns], snapshot.y.values[rows]
    drawn = ax.scatter(x, y, s=9, c=B[rows, columns], vmin=0, vmax=1, cmap="inferno")
    figure.colorbar(drawn, ax=ax, label="B = u / c (1), crests break above 0.85")
    return figure
