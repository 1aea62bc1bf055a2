"""Exact cameras of simulated experiments: the rig of Aubourg et al. (2019), light sheets, a sea platform."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wavefield.rig import Camera, Rig
from wavefield.rig.field import view_on_water

Array = NDArray[np.float64]

# name: (side, distance from the aim in m, aim in m, roll in degrees, focal length in px, size in px,
# distortion k1, Scheimpflug tilt in rad). Small rolls, offsets and distortions, as in any real rig, reveal
# wrong signs.
_PAPER = {
    "cam1": (-1, 4.50, (-0.20, 0.004, 0.0), 0.4, 35e-3 / 12.0e-6, (1024, 1024), -0.05, -0.008),
    "cam2": (+1, 4.50, (+0.20, -0.006, 0.0), -0.6, 35e-3 / 12.0e-6, (1024, 1024), -0.04, +0.008),
    "cam3": (0, 4.35, (0.003, 0.002, 0.0), 0.3, 35e-3 / 7.4e-6, (2432, 1728), 0.06, 0.0),
}


def paper_rig(scale: float = 1.0, crop: float = 1.0, cameras: int = 3) -> Rig:
    """Return the exact cameras of Aubourg et al. (2019), with 35 mm lenses.

    Cameras 1 and 2 (1024 x 1024 px) look from -x and +x, at 45 degrees and from 4.5 m, with slightly tilted
    (Scheimpflug) sensors; a pixel covers 1.5 mm in y and 2.2 mm in x. Camera 3 (2432 x 1728 px) is 4.35 m
    above the water; a pixel covers 0.92 mm.

    Parameters
    ----------
    scale : float, default 1
        Image size relative to the full size; 0.5 halves the resolution.
    crop : float, default 1
        Fraction of the sensor read out along each axis; 0.4 shows 0.9 x 0.7 m at full resolution.
    cameras : {2, 3, 4}, default 3
        2: only the oblique ones, from -x and +x; 4: one more, like camera 1 but from -y.

    Returns
    -------
    Rig
        Cameras ``cam1``, ``cam2``, and so on.

    Examples
    --------
    >>> paper_rig(0.5)["cam3"].size
    (1216, 864)
    """
    made = {}
    for name, (side, distance, aim, roll, focal, size, k1, tilt) in _PAPER.items():
        # aiming off centre balances near and far side, an effect that is quadratic in the size of the field
        target = np.array(aim) * [crop * crop, 1.0, 1.0]
        angle = np.radians(45.0 * side)
        centre = target + distance * np.array([np.sin(angle), 0.0, np.cos(angle)])
        rotation = _orientation((target - centre) / distance, np.radians(roll))
        read_out = (round(size[0] * crop), round(size[1] * crop))
        camera = _camera(focal, rotation, -rotation @ centre, read_out, k1, tilt)
        made[name] = camera if scale == 1.0 else camera.scaled(scale)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    made["cam4"] = replace(made["cam1"], rotation=np.asarray(made["cam1"].rotation) @ quarter.T)
    chosen = dict(list(made.items())[:cameras])
    return Rig(chosen, {"source": f"exact cameras of the paper, scale {scale:g}, crop {crop:g}"})


def sheet_rig(cameras: int, angle: float, distance: float, pixel: float, size: tuple[int, int]) -> Rig:
    """Return cameras at `angle` degrees from a light sheet's normal; if `cameras` is 3, one is vertical.
    `distance` from the sheet and the size `pixel` of a pixel on it are in m; `size` is (width, height),
    px. The sensors of the two oblique cameras are tilted (Scheimpflug)."""
    made = {}
    for name, side, roll, k1 in (("cam1", -1, 0.4, -0.04), ("cam2", 1, -0.5, -0.03), ("cam3", 0, 0.3, 0.03)):
        lean = np.radians(angle * side)
        rotation = _orientation(-np.array([np.sin(lean), 0.0, np.cos(lean)]), np.radians(roll))
        made[name] = _camera(
            distance / pixel, rotation, np.array([0.0, 0.0, distance]), size, k1, side * 0.02
        )
    chosen = dict(list(made.items())[:cameras])
    return Rig(chosen, {"source": f"exact cameras around a light sheet, {angle:g} degrees"})


def platform_rig(height: float, baseline: float, pitch: float, focal: float, size: tuple[int, int]) -> Rig:
    """Return cameras `left` and `right` at a `height` above the sea, m, that look towards +y.
    `baseline`, m, is the distance between the cameras and `pitch`, degrees, the angle of their optical
    axes below the horizontal. The `focal` length and the `size` of the images (width, height) are in px."""
    made = {}
    for name, side, roll, turn, down, k1 in (
        ("left", -1, 0.8, 1.1, 0.3, -0.05),
        ("right", 1, -0.5, -0.9, -0.2, -0.04),
    ):
        p, yaw = np.radians([pitch + down, turn * -side])
        axis = np.array([np.sin(yaw) * np.cos(p), np.cos(yaw) * np.cos(p), -np.sin(p)])
        right = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
        c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
        below = np.cross(axis, right)
        rotation = np.array([c * right + s * below, c * below - s * right, axis])
        centre = np.array([0.5 * side * baseline, 0.0, height])
        made[name] = _camera(focal, rotation, -rotation @ centre, size, k1, 0.0)
    return Rig(made, {"source": f"exact cameras on a platform, {height:g} m above the sea"})


def _camera(
    focal: float, rotation: Array, translation: Array, size: tuple[int, int], k1: float, tilt: float
) -> Camera:
    middle = (size[0] - 1) / 2.0, (size[1] - 1) / 2.0
    return Camera(focal, focal, *middle, rotation, translation, size, k1=k1, tau_y=tilt)


def _orientation(axis: Array, roll: float) -> Array:
    """Return the rotation (3, 3) from world to camera of a camera that looks along `axis` (3,).
    `roll`, rad, is its rotation about this axis."""
    down = np.array([0.0, -1.0, 0.0])
    right = np.cross(down, axis)
    c, s = np.cos(roll), np.sin(roll)
    return np.array([c * right + s * down, c * down - s * right, axis])


def bounds(
    rig: Rig, lowest: float, highest: float, margin: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the limits in x and in y, m, of all water that any camera sees, widened by `margin`, m.
    The water may be at any height from `lowest` to `highest`, m."""
    corners = np.concatenate([_bounding(rig[name], z) for name in rig for z in (lowest, highest)])
    low, high = np.nanmin(corners, axis=0) - margin, np.nanmax(corners, axis=0) + margin
    return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))


def _bounding(camera: Camera, height: float) -> Array:
    """Return points (n, 2), m, around the part of the horizontal plane at `height`, m, that the camera sees.
    If the camera sees the horizon, only nearby water is included."""
    corners = camera.corners(height)
    if np.isfinite(corners).all():
        return corners
    x, y = view_on_water(camera).T
    return np.stack(camera.unproject(*camera.project(x, y, 0.0), height), axis=-1)


def pixel_footprint(camera: Camera) -> tuple[float, float]:
    """Return the size along x and along y, m, of the image's middle pixel projected to still water."""
    x, y = camera.unproject((camera.size[0] - 1) / 2, (camera.size[1] - 1) / 2)
    jacobian = camera.jacobian(x, y, 0.0)
    return float(1.0 / np.hypot(*jacobian[:, 0])), float(1.0 / np.hypot(*jacobian[:, 1]))
