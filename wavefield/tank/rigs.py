"""The paper's rig: three cameras in line along x, 45 degrees apart, the middle one vertical."""

from dataclasses import replace

import numpy as np

from wavefield.rig import Camera, Rig

# name: (side, distance from the aim, aim, roll, pixel pitch, size, k1, Scheimpflug tilt)
# The small rolls, offsets and distortions are those of any real rig; without them a sign error could hide.
_PAPER = {
    "cam1": (-1, 4.50, (-0.20, 0.004, 0.0), 0.4, 12.0e-6, (1024, 1024), -0.05, -0.008),
    "cam2": (+1, 4.50, (+0.20, -0.006, 0.0), -0.6, 12.0e-6, (1024, 1024), -0.04, +0.008),
    "cam3": (0, 4.35, (0.003, 0.002, 0.0), 0.3, 7.4e-6, (2432, 1728), 0.06, 0.0),
}
_FOCAL_LENGTH = 35e-3


def paper_rig(scale: float = 1.0, crop: float = 1.0, cameras: int = 3) -> Rig:
    """Exact cameras as in the paper: 35 mm lenses, cameras 1 and 2 of 1024 x 1024, camera 3 of 2432 x 1728.

    Cameras 1 and 2 look from -x and +x at 45 degrees from 4.5 m through slightly tilted (Scheimpflug)
    sensors: 1.5 mm/px in y and 2.2 mm/px in x. Camera 3 looks down from 4.35 m: 0.92 mm/px.

    Parameters
    ----------
    scale : float, default 1
        Size of the images over the full size; 0.5 halves the resolution.
    crop : float, default 1
        Share of the sensor that is read out, along each axis; 0.4 shows 0.9 x 0.7 m at the full resolution.
    cameras : {2, 3, 4}, default 3
        2: the oblique ones, from -x and +x, alone; 4: one more like camera 1, from -y.

    Returns
    -------
    Rig
        Cameras ``cam1``, ``cam2``, ``cam3``, ``cam4``, as many as there are.

    Examples
    --------
    >>> paper_rig(0.5)["cam3"].size
    (1216, 864)
    """
    made = {}
    for name, (side, distance, aim, roll, pitch, size, k1, tilt) in _PAPER.items():
        # the off-centre aim balances the near and the far side: an effect of second order in the field
        target = np.array(aim) * [crop * crop, 1.0, 1.0]
        angle = np.radians(45.0 * side)
        centre = target + distance * np.array([np.sin(angle), 0.0, np.cos(angle)])
        axis = (target - centre) / distance
        down = np.array([0.0, -1.0, 0.0])  # rows run towards -y
        turn = np.radians(roll)
        right = np.cross(down, axis)
        right, down = (
            np.cos(turn) * right + np.sin(turn) * down,
            np.cos(turn) * down - np.sin(turn) * right,
        )
        rotation = np.array([right, down, axis])
        kept = (round(size[0] * crop), round(size[1] * crop))
        focal = _FOCAL_LENGTH / pitch
        camera = Camera(
            fx=focal,
            fy=focal,
            cx=(kept[0] - 1) / 2.0,
            cy=(kept[1] - 1) / 2.0,
            rotation=rotation,
            translation=-rotation @ centre,
            size=kept,
            k1=k1,
            tau_y=tilt,
        )
        made[name] = camera if scale == 1.0 else camera.scaled(scale)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    made["cam4"] = replace(made["cam1"], rotation=np.asarray(made["cam1"].rotation) @ quarter.T)
    chosen = dict(list(made.items())[:cameras])
    return Rig(chosen, {"source": f"exact cameras of the paper, scale {scale:g}, crop {crop:g}"})


def sheet_rig(cameras: int, angle: float, distance: float, pixel: float, size: tuple[int, int]) -> Rig:
    """Exact cameras around a light sheet, with tilted sensors (Scheimpflug) where they look from the side.

    With angle, degrees; distance, metres; pixel, metres; size, px.

    Examples
    --------
    >>> list(sheet_rig(2, 35.0, 1.0, 2e-4, (800, 600)))
    ['cam1', 'cam2']
    """
    made = {}
    for name, side, roll, k1 in (("cam1", -1, 0.4, -0.04), ("cam2", 1, -0.5, -0.03), ("cam3", 0, 0.3, 0.03)):
        turn, lean = np.radians(roll), np.radians(angle * side)
        tilt = side * 0.02
        rotation = _orientation(lean, turn)
        focal = distance / pixel
        made[name] = Camera(
            fx=focal,
            fy=focal,
            cx=(size[0] - 1) / 2.0,
            cy=(size[1] - 1) / 2.0,
            rotation=rotation,
            translation=np.array([0.0, 0.0, distance]),
            size=size,
            k1=k1,
            tau_y=float(tilt),
        )
    chosen = dict(list(made.items())[:cameras])
    return Rig(chosen, {"source": f"exact cameras around a light sheet, {angle:g} degrees"})


def _orientation(lean: float, turn: float) -> np.ndarray:
    """Rotation of a camera that looks down at the origin, from +x by ``lean``, rolled by ``turn``, rad."""
    axis = -np.array([np.sin(lean), 0.0, np.cos(lean)])
    down = np.array([0.0, -1.0, 0.0])
    right = np.cross(down, axis)
    c, s = np.cos(turn), np.sin(turn)
    return np.array([c * right + s * down, c * down - s * right, axis])


def bounds(
    rig: Rig, lowest: float, highest: float, margin: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Smallest rectangle of water that holds everything any camera sees.

    With lowest, highest, metres; margin, metres; returns x, y Limits along each axis, metres.
    """
    corners = np.concatenate([rig[name].corners(z) for name in rig for z in (lowest, highest)])
    lo, hi = np.nanmin(corners, axis=0) - margin, np.nanmax(corners, axis=0) + margin
    return (float(lo[0]), float(hi[0])), (float(lo[1]), float(hi[1]))


def pixel_footprint(camera: Camera) -> tuple[float, float]:
    """Size of a pixel on the water at rest, in the middle of the image.

    Returns x, y Extent along x and along y, metres per px.
    """
    x, y = camera.unproject((camera.size[0] - 1) / 2, (camera.size[1] - 1) / 2)
    jacobian = camera.jacobian(x, y, 0.0)
    return float(1.0 / np.hypot(*jacobian[:, 0])), float(1.0 / np.hypot(*jacobian[:, 1]))
