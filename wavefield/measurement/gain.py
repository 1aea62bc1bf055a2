"""The gain of the matching windows by linear theory, from plan and cameras: no simulation is needed."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wavefield import matching
from wavefield.measurement.plan import Plan

Array = NDArray[np.float64]

_BLOCK = 5  # px: side of matching's blocks
# px^2: variance of the area that a block's value stands for, as simulated experiments have it; the filter of
# matching takes more, because it also makes up for what few beads lose
_FOOTPRINT = 5.5


def gains(plan: Plan, kx: Array, ky: Array) -> dict[str, Array]:
    """Amplitude gains of what a plan measures.

    Parameters
    ----------
    plan : Plan
        Of a measurement.
    kx, ky : ndarray
        Wavenumbers, rad/m.

    Returns
    -------
    dict of str to ndarray
        z, u, v and w, each of the wavenumbers' shape.

    Notes
    -----
    Window, smoother and steps of every level of the pyramid (`matching.transfer_function`), the area of
    blocks and beads, the filter and the spline on the lattice; for velocities each camera's displacement
    in its own pixels at the middle of the grid, then the least squares of all.
    """
    velocity = _velocity(plan, kx, ky)
    return {"z": _surface(plan, kx, ky)} | {name: velocity[..., i, i] for i, name in enumerate("uvw")}


def matched(settings: matching.Settings, kx: Array, ky: Array) -> Array:
    """Gain of a displacement field at the centres of matching's blocks.

    Parameters
    ----------
    settings : matching.Settings
        Those of the match.
    kx, ky : ndarray
        Wavenumbers along columns and rows, rad per block.

    Returns
    -------
    ndarray
        Amplitude gain.
    """
    total = matching.transfer_function(settings, kx, ky)
    return np.asarray(total * np.exp(-0.5 * _FOOTPRINT * (kx**2 + ky**2) / _BLOCK**2))


def _read(response: Array, kx: Array, ky: Array) -> Array:
    # between the blocks: the filter of the lattice's cosines, then the cubic spline of what it gives
    ny, nx = response.shape
    places = [np.abs(ky) / np.pi * ny, np.abs(kx) / np.pi * nx]
    gain = ndimage.map_coordinates(response, places, order=1, mode="nearest")
    for q in (kx, ky):
        gain = np.where(np.abs(q) < np.pi, gain * np.sinc(q / (2 * np.pi)) ** 4, 0.0)
    return gain


def _surface(plan: Plan, kx: Array, ky: Array) -> Array:
    kx, ky = kx * _BLOCK * plan.pixel, ky * _BLOCK * plan.pixel
    return matched(plan.settings.stereo, kx, ky) * _read(plan.response, kx, ky)


def _velocity(plan: Plan, kx: Array, ky: Array) -> Array:
    # (..., 3, 3): displacement measured for one that is there
    grid = plan.grid
    middle = 0.5 * (grid.x[0] + grid.x[1]), 0.5 * (grid.y[0] + grid.y[1])
    jacobians: list[Any] = [plan.binned[name].jacobian(*middle, 0.0) for name in plan.velocity_cameras]
    inverse = np.linalg.pinv(np.concatenate(jacobians))
    out = np.zeros((*kx.shape, 3, 3))
    for i, (name, jacobian) in enumerate(zip(plan.velocity_cameras, jacobians)):
        to_water = _BLOCK * np.linalg.inv(jacobian[:, :2])
        q = np.stack([kx, ky], axis=-1) @ to_water
        gain = matched(plan.settings.piv, q[..., 0], q[..., 1])
        gain *= _read(plan.sights[name].response, q[..., 0], q[..., 1])
        out += gain[..., None, None] * (inverse[:, 2 * i : 2 * i + 2] @ jacobian)
    return out
