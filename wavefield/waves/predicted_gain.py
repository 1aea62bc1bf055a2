"""The gain of the matching windows by linear theory, from the recipe of a cube: no simulation is needed."""

import json
from typing import Any

import numpy as np
import xarray as xr
from scipy import ndimage

from wavefield import matching
from wavefield.errors import CubeError
from wavefield.grid import Grid
from wavefield.measurement import Plan, Settings
from wavefield.rig import Camera, Rig
from wavefield.waves.window_gain import DIRECTIONS, label

_BLOCK = 5  # px: side of matching's blocks
# px^2: variance of the area that a block's value stands for, as simulated experiments have it; the filter of
# matching takes more, because it also makes up for what few beads lose
_FOOTPRINT = 5.5


def predicted_gain(cube: xr.Dataset) -> xr.Dataset:
    """Predict the gain of the matching windows from the settings and cameras of a cube.

    Parameters
    ----------
    cube : Dataset
        A cube with its recipe among its attributes, as `wavefield run` writes it.

    Returns
    -------
    Dataset
        As `window_gain` gives it, without coherences.

    Raises
    ------
    CubeError
        If the cube does not say how it was made.

    Notes
    -----
    Window, smoother and steps of every level of the pyramid (`matching.transfer_function`), the area of
    blocks and beads, the filter and the spline on the lattice; for velocities each camera's displacement
    in its own pixels at the middle of the grid, then the least squares of all.
    """
    try:
        recipe = json.loads(cube.attrs["recipe"])
        rig = Rig({name: Camera.from_dict(camera) for name, camera in recipe["rig"].items()})
        grid = Grid(**recipe["grid"])
        settings = Settings.from_dict(recipe["settings"])
    except (KeyError, TypeError, ValueError) as error:
        raise CubeError(
            f"the cube does not say how it was made ({error}): measure the gain of its windows, window_gain"
        ) from None
    plan = Plan(rig, grid, settings)
    top = np.sqrt(2) * np.pi / grid.step
    k = np.linspace(0, top, 200)
    angle = np.arange(DIRECTIONS)[:, None] * np.pi / DIRECTIONS
    kx, ky = k * np.cos(angle), k * np.sin(angle)
    velocity = _velocity(plan, kx, ky)
    gains = {"z": _surface(plan, kx, ky)} | {name: velocity[..., i, i] for i, name in enumerate("uvw")}
    return label(gains, k, "linear theory")


def matched(settings: matching.Settings, kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
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
    return total * np.exp(-0.5 * _FOOTPRINT * (kx**2 + ky**2) / _BLOCK**2)


def _read(response: np.ndarray, kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
    # between the blocks: the filter of the lattice's cosines, then the cubic spline of what it gives
    ny, nx = response.shape
    places = [np.abs(ky) / np.pi * ny, np.abs(kx) / np.pi * nx]
    gain = ndimage.map_coordinates(response, places, order=1, mode="nearest")
    for q in (kx, ky):
        gain = np.where(np.abs(q) < np.pi, gain * np.sinc(q / (2 * np.pi)) ** 4, 0.0)
    return gain


def _surface(plan: Plan, kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
    kx, ky = kx * _BLOCK * plan.pixel, ky * _BLOCK * plan.pixel
    return matched(plan.settings.stereo, kx, ky) * _read(plan.response, kx, ky)


def _velocity(plan: Plan, kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
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
