"""The gain of the matching windows by linear theory, from the recipe of a cube: no simulation is needed."""

import json
from typing import Any

import numpy as np
import xarray as xr

from wavefield import matching
from wavefield.errors import CubeError
from wavefield.grid import Grid
from wavefield.measurement import Plan, Settings
from wavefield.rig import Camera, Rig
from wavefield.waves.window_gain import DIRECTIONS, label

_BLOCK = 5  # px: side of matching's blocks
_STEP = 0.8  # what a step of the matching achieves of its way among beads, relaxation included


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
    Window, smoother and steps at every level of the pyramid (`matching.transfer_kernel`), the mean over a
    block, the thin plate and the spline on the lattice of blocks; for velocities each camera's displacement
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
    kernel = matching.transfer_kernel(settings, _STEP).astype(float)
    reach = len(kernel) // 2
    n = np.arange(-reach, reach + 1)
    rows, columns = (np.exp(1j * q[..., None] * n) for q in (ky, kx))
    total = np.einsum("...i,ij,...j->...", rows, kernel, columns, optimize=True).real
    return total * np.sinc(kx / (2 * np.pi)) * np.sinc(ky / (2 * np.pi))


def _read(gain: np.ndarray, smoothing: float, kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
    # between the blocks: the thin plate, then the cubic spline through it
    bend = (2 - 2 * np.cos(kx)) + (2 - 2 * np.cos(ky))
    gain = gain / (1 + smoothing * bend**2)
    for q in (kx, ky):
        spline = np.sinc(q / (2 * np.pi)) ** 4 * 3 / (2 + np.cos(q))
        gain = np.where(np.abs(q) < np.pi, gain * spline, 0.0)
    return gain


def _surface(plan: Plan, kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
    block = _BLOCK * plan.pixel
    kx, ky = kx * block, ky * block
    return _read(matched(plan.settings.stereo, kx, ky), plan.settings.smoothing, kx, ky)


def _velocity(plan: Plan, kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
    # (..., 3, 3): displacement measured for one that is there
    grid = plan.grid
    middle = 0.5 * (grid.x[0] + grid.x[1]), 0.5 * (grid.y[0] + grid.y[1])
    jacobians: list[Any] = [plan.binned[name].jacobian(*middle, 0.0) for name in plan.velocity_cameras]
    inverse = np.linalg.pinv(np.concatenate(jacobians))
    out = np.zeros((*kx.shape, 3, 3))
    for i, jacobian in enumerate(jacobians):
        to_water = _BLOCK * np.linalg.inv(jacobian[:, :2])
        q = np.stack([kx, ky], axis=-1) @ to_water
        gain = _read(matched(plan.settings.piv, q[..., 0], q[..., 1]), 0.0, q[..., 0], q[..., 1])
        out += gain[..., None, None] * (inverse[:, 2 * i : 2 * i + 2] @ jacobian)
    return out
