"""Amplitude gain of the measurement for waves, by linear theory: MAP estimate and interpolation."""

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

PLACES = 3  # along x and along y, at which the gain of velocities is taken
DIRECTIONS = 8  # of crests, over half a turn: along x, along y and between
WAVENUMBERS = 200  # up to the corner of those that the grid resolves


def tabulated(geometry: GridGeometry, record: LearnedRecord | None) -> dict[str, Float]:
    """Gains of z, u, v, w as they are stored with a cube, with ``direction`` (8,), rad, over half a turn."""
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
        Of the measurement.
    record : LearnedRecord
        Its learned record.
    kx, ky : ndarray
        Wavenumbers, rad/m.

    Returns
    -------
    dict of str to ndarray
        z, u, v and w, each of the wavenumbers' shape; without the gain of paths in time (`time_weights`).

    Notes
    -----
    The MAP field has the gain S / (S + N), with the spectrum S and the noise N of the blocks that
    were learned from sample frames; for velocities that of each camera's displacement in its own pixels,
    then the least squares of all, as the mean over the grid: at grazing sight pixels are several times as
    long far away as near.
    """
    velocity = gain_of_velocity(geometry, record, kx, ky)
    out = {name: velocity[..., i, i] for i, name in enumerate("uvw")}
    return {"z": gain_of_elevation(geometry, record, kx, ky)} | out


def shortest_carried(geometry: GridGeometry, record: LearnedRecord) -> dict[str, float]:
    """Wavelength at which the gain of z, u, v, w is one half, mean over directions, metres."""
    k = np.linspace(0.0, np.pi / geometry.grid.step, 600)
    angle = np.arange(8)[:, None] * np.pi / 8
    kx, ky = k * np.cos(angle), k * np.sin(angle)
    out = {}
    for name, gain in gains(geometry, record, kx, ky).items():
        below = np.flatnonzero(gain.mean(axis=0) < 0.5)
        out[name] = float(2 * np.pi / k[max(below[0], 1)]) if below.size else 2.0 * geometry.grid.step
    return out


def gain_of_elevation(geometry: GridGeometry, record: LearnedRecord, kx: Float, ky: Float) -> Float:
    """Gain of z at wavenumbers kx, ky, rad/m."""
    step = BLOCK * geometry.pixel
    return np.asarray(_gain_between_blocks(record.elevation, kx * step, ky * step)[0])


def gain_of_velocity(geometry: GridGeometry, record: LearnedRecord, kx: Float, ky: Float) -> Float:
    """Matrix from true to measured (dx, dy, dz), S + (3, 3), at wavenumbers kx, ky of shape S, rad/m."""
    x, y = (np.linspace(*side, 2 * PLACES + 1)[1::2] for side in (geometry.grid.x, geometry.grid.y))
    gains = [_gain_of_velocity_at(place, geometry, record, kx, ky) for place in product(x, y)]
    return np.asarray(np.mean(gains, axis=0))


def _gain_of_velocity_at(
    place: tuple[float, float], geometry: GridGeometry, record: LearnedRecord, kx: Float, ky: Float
) -> Float:
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
    """Gain of the MAP field, (1 or c,) + S, read between the blocks; wavenumbers S in rad per block."""
    gain: Float = prior.gain(qx, qy)
    return gain * interpolation_gain(qx) * interpolation_gain(qy)
