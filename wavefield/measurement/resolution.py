"""Amplitude gain of the measurement for waves, by linear theory: MAP estimate and interpolation to nodes."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.kernels import BLOCK
from wavefield.matching.spectrum import Prior
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.model import LearnedRecord
from wavefield.measurement.regrid import interpolation_gain

Float = NDArray[np.floating[Any]]

PLACES = 3  # positions along x and along y over which the gain of velocities is averaged
DIRECTIONS = 8  # directions in the stored table, over half a turn
WAVENUMBERS = 200  # wavenumbers in the stored table, up to the diagonal Nyquist wavenumber of the grid


def tabulated(geometry: GridGeometry, record: LearnedRecord | None) -> dict[str, Float]:
    """Return the table of gains that is stored with a cube: ``gain_z``, ``gain_u``, ... (8, 200).
    They belong to ``direction`` (8,), rad, over half a turn, and ``k`` (200,), rad/m; NaN if unknown."""
    k = np.linspace(0, np.sqrt(2) * np.pi / geometry.grid.step, WAVENUMBERS)
    direction = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    unknown = np.full((DIRECTIONS, WAVENUMBERS), np.nan)
    found = dict.fromkeys("zuvw", unknown)
    if record is not None:
        found = gains(geometry, record, k * np.cos(direction[:, None]), k * np.sin(direction[:, None]))
        if geometry.settings.sheet_thickness is not None:
            found["z"] = unknown
    return {"direction": direction, "k": k} | {f"gain_{name}": values for name, values in found.items()}


def gains(geometry: GridGeometry, record: LearnedRecord, kx: Float, ky: Float) -> dict[str, Float]:
    """Amplitude gains of the measured fields.

    Parameters
    ----------
    geometry : GridGeometry
        Rig, grid and settings of the measurement.
    record : LearnedRecord
        The learned record of the measurement.
    kx, ky : ndarray
        Wavenumbers, rad/m.

    Returns
    -------
    dict of str to ndarray
        Gains of z, u, v and w, each with the shape of the wavenumbers. The gain of interpolation in time
        (`path_gain`) is not included.

    Notes
    -----
    The MAP field has the gain S / (S + N), with the learned spectrum S and noise N of the blocks. For
    velocities, this gain applies to the displacement of each camera in its own pixels; least squares over the
    cameras then gives that of u, v, w. It is averaged over the grid, because an oblique camera has much
    longer pixels on the water far away than near.
    """
    step = BLOCK * geometry.pixel
    z = _gain_between_blocks(record.elevation, kx * step, ky * step)[0]
    x, y = (np.linspace(*side, 2 * PLACES + 1)[1::2] for side in (geometry.grid.x, geometry.grid.y))
    velocity = np.mean([_gain_of_velocity(at, geometry, record, kx, ky) for at in product(x, y)], axis=0)
    return {"z": z} | {name: velocity[..., i, i] for i, name in enumerate("uvw")}


def shortest_carried(geometry: GridGeometry, record: LearnedRecord) -> dict[str, float]:
    """Return the wavelengths, m, at which the gains fall to one half on average, or else two grid steps."""
    k = np.linspace(0.0, np.pi / geometry.grid.step, 600)
    angle = np.arange(8)[:, None] * np.pi / 8
    kx, ky = k * np.cos(angle), k * np.sin(angle)
    out = {}
    for name, gain in gains(geometry, record, kx, ky).items():
        below = np.flatnonzero(gain.mean(axis=0) < 0.5)
        out[name] = float(2 * np.pi / k[max(below[0], 1)]) if below.size else 2.0 * geometry.grid.step
    return out


def _gain_of_velocity(
    place: tuple[float, float], geometry: GridGeometry, record: LearnedRecord, kx: Float, ky: Float
) -> Float:
    """Return matrices from true to measured displacements (dx, dy, dz) at a place x, y, (..., 3, 3)."""
    jacobians: list[Any] = [
        geometry.sights[name].camera.jacobian(*place, 0.0) for name, _ in record.displacement
    ]
    inverse = np.linalg.pinv(np.concatenate(jacobians))
    out = np.zeros((*np.broadcast_shapes(np.shape(kx), np.shape(ky)), 3, 3))
    for i, ((_, prior), jacobian) in enumerate(zip(record.displacement, jacobians)):
        q = np.stack([kx, ky], axis=-1) @ (BLOCK * np.linalg.inv(jacobian[:, :2]))
        gain = _gain_between_blocks(prior, q[..., 0], q[..., 1])
        for n in range(2):
            out += gain[min(n, len(gain) - 1), ..., None, None] * np.outer(inverse[:, 2 * i + n], jacobian[n])
    return out


def _gain_between_blocks(prior: Prior, qx: Float, qy: Float) -> Float:
    """Return the gain (component, ...) of a MAP field between blocks, at qx, qy, rad per block."""
    gain: Float = prior.gain(qx, qy)
    return gain * interpolation_gain(qx) * interpolation_gain(qy)
