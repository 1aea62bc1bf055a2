"""The exact answer at the nodes of the grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wavefield.grid import Grid
from wavefield.tank.basin import Basin
from wavefield.tank.beads import carry

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Truth:
    """One step, from ``time - dt/2`` to ``time + dt/2``; every array is (ny, nx).

    Parameters
    ----------
    time : float
        Mid-time, s.
    z, u, v, w : ndarray
        Elevation (m) and velocity of the surface water (m/s) at mid-time, instantaneous.
    z_rate : ndarray
        Instantaneous rate of rise at mid-time, m/s: w = z_rate + u dz/dx + v dz/dy holds exactly.
    z_t : ndarray
        Rise over the step, (z(t + dt/2) - z(t - dt/2)) / dt at the node, m/s.
    z_start, z_end : ndarray
        Elevation at the two frames, m.
    dx, dy, dz : ndarray
        Displacement over the step of the water whose path has its mid-point (half-way between both ends)
        above the node, m.
    """

    time: float
    z: Array
    z_t: Array
    z_rate: Array
    u: Array
    v: Array
    w: Array
    z_start: Array
    z_end: Array
    dx: Array
    dy: Array
    dz: Array


def truth(basin: Basin, grid: Grid, time: float, dt: float) -> Truth:
    """Exact fields for one step.

    Parameters
    ----------
    basin : Basin
        The sea around the grid.
    grid : Grid
        The nodes.
    time : float
        Mid-time of the step, s.
    dt : float
        Length of the step, s.

    Returns
    -------
    Truth
    """
    x, y = grid.x_nodes, grid.y_nodes
    nodes = np.meshgrid(x, y)
    fields = basin.sea.on_grid(x, y, time)
    start = basin.sea.on_grid(x, y, time - dt / 2, ("z",))["z"]
    end = basin.sea.on_grid(x, y, time + dt / 2, ("z",))["z"]
    dx, dy, dz = displacement(basin, nodes[0], nodes[1], time, dt)
    return Truth(
        time=time,
        z=fields["z"],
        z_t=(end - start) / dt,
        z_rate=fields["z_t"],
        u=fields["u"],
        v=fields["v"],
        w=fields["w"],
        z_start=start,
        z_end=end,
        dx=dx,
        dy=dy,
        dz=dz,
    )


def displacement(basin: Basin, x: Array, y: Array, time: float, dt: float) -> tuple[Array, Array, Array]:
    """Displacement over a step of the water whose path has its mid-point above given points.

    Parameters
    ----------
    basin : Basin
        The sea around the points.
    x, y : ndarray, S
        Points, metres.
    time : float
        Mid-time of the step, s.
    dt : float
        Length of the step, s.

    Returns
    -------
    dx, dy, dz : ndarray, S
        Metres.

    Notes
    -----
    The water is followed from mid-time both ways; its place at mid-time is corrected until the mean of both
    ends is the point.
    """
    px, py = x, y
    for _ in range(3):
        ax, ay = carry(basin, px, py, time, time - dt / 2)
        bx, by = carry(basin, px, py, time, time + dt / 2)
        px, py = px + x - (ax + bx) / 2, py + y - (ay + by) / 2
    (za,) = basin.snapshot(time - dt / 2, ("z",))(ax, ay)
    (zb,) = basin.snapshot(time + dt / 2, ("z",))(bx, by)
    return bx - ax, by - ay, zb - za
