"""The exact fields of a simulated experiment at the nodes of the grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wavefield.grid import Grid
from wavefield.tank.beads import carry, centred_path
from wavefield.tank.sea import Basin

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Truth:
    """Exact fields of one step, from ``time - dt/2`` to ``time + dt/2``; every array is (ny, nx).

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
        Displacement over the step, m, of the water whose path has its mid-point (the mean of both ends) at
        the node.
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
    """Return the exact fields at the nodes of a grid for one step of length `dt` around `time`, both in s."""
    x, y = grid.x_nodes, grid.y_nodes
    fields = basin.sea.on_grid(x, y, time)
    start, end = (basin.sea.on_grid(x, y, t, ("z",))["z"] for t in (time - dt / 2, time + dt / 2))
    node_x, node_y = np.meshgrid(x, y)
    dx, dy, dz = displacement(basin, node_x, node_y, time, dt)
    z, u, v, w = (fields[name] for name in ("z", "u", "v", "w"))
    return Truth(time, z, (end - start) / dt, fields["z_t"], u, v, w, start, end, dx, dy, dz)


def displacement(basin: Basin, x: Array, y: Array, time: float, dt: float) -> tuple[Array, Array, Array]:
    """Return the displacements along x, y and z, m, of the water in a step `dt` around `time`, both in s.
    The mean of the start and the end of each path is at the point x, y, m."""

    def carried(px: Array, py: Array, after: float) -> Array:
        return np.stack(carry(basin, px, py, time, time + after))

    start, end = centred_path(carried, x, y, dt / 2)
    (z_start,) = basin.snapshot(time - dt / 2, ("z",))(*start)
    (z_end,) = basin.snapshot(time + dt / 2, ("z",))(*end)
    return end[0] - start[0], end[1] - start[1], z_end - z_start
