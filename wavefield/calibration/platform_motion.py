"""Frames of a platform that rolls and pitches, turned level one by one by the horizon."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from wavefield.atomic_write import NEW_FILE, write_text
from wavefield.calibration.horizon import MAX_MISFIT, dip, find_horizon, sight_lines
from wavefield.errors import RigError
from wavefield.images import write_image
from wavefield.rig import Camera, Rig
from wavefield.rig.lens import Array
from wavefield.rig.rotation import rotation_about
from wavefield.series import Experiment, masks
from wavefield.series.frames import FrameSeries

REFRACTION_STD = 0.07  # of the dip: what air that is warmer or colder than the water bends light by
MIN_HORIZONS = 3  # images, for how much a camera sways
FAR = 1e5  # m: what is drawn of the sky, and of water further away
KEPT = ("name", "frame_rate", "surface", "velocity", "grid", "settings", "water")  # of the lab note
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class PlatformMotion:
    """How a platform moved, and the experiment whose frames are turned level."""

    experiment: Path
    rig: Rig  # that of all turned frames
    tilt: Array  # (frames, 2): of the rig about x (pitch) and y (roll), degrees; NaN without a horizon
    # Of one frame, degrees, from what its cameras differ by (NaN of one camera) and the refraction of the air
    tilt_std: float

    @property
    def sentence(self) -> str:
        """All this for the user."""
        seen = np.isfinite(self.tilt[:, 0])
        pitch, roll = np.std(self.tilt[seen], axis=0)
        height = float(np.mean([camera.centre[2] for camera in self.rig.cameras.values()]))
        tan = np.tan(np.radians(self.tilt_std))
        return (
            f"{seen.sum()} of {len(seen)} frames show the horizon and were turned level: pitch {pitch:.2f} "
            f"and roll {roll:.2f} degrees (rms), each known to {self.tilt_std:.3f} degrees, that is "
            f"{100 * tan * 3 * height:.1g} cm of z at {3 * height:.0f} m, which z_std does not contain"
        )


def level_frames(
    experiment: str | Path | Experiment,
    folder: str | Path,
    rig: str | Path | Rig | None = None,
    progress: Progress | None = None,
) -> PlatformMotion:
    """Write the frames of a platform that rolls and pitches as a platform at rest would have taken them.

    The horizon in each frame gives roll and pitch. Every image is drawn anew, through the mean surface, for
    cameras that do not move; a wave of elevation z at distance d is displaced by a few parts in a thousand
    of z at tilts of some degrees. Frames without a horizon are left out. Heave, sway and yaw stay.

    Parameters
    ----------
    experiment : path or Experiment
        Of cameras that all show the horizon.
    folder : path
        Made, and empty if it is there: ``experiment.yaml``, ``rig.yaml``, ``<camera>/img_<frame>.tif``.
    rig : path or Rig, optional
        In place of the one that the experiment names; z = 0 is the mean surface, to some degrees.
    progress : callable, optional
        Called with (frames done, all frames).

    Returns
    -------
    PlatformMotion

    Raises
    ------
    RigError
        If no frame shows the horizon, or the folder is not empty.

    Examples
    --------
    >>> import wavefield as wf
    >>> moved = wf.level_frames("experiment.yaml", "level", "rig.yaml")  # doctest: +SKIP
    >>> moved.tilt.shape  # doctest: +SKIP
    (40, 2)
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RigError(f"{folder} is not empty; give another folder")
    if not isinstance(experiment, Experiment):
        experiment = Experiment.load(experiment)
    series = experiment.open_frames()
    loaded = rig if isinstance(rig, Rig) else experiment.load_rig(rig, series)
    in_images = {name: shapes for name, shapes in experiment.mask.items() if name != masks.WATER}
    series = masks.covered_series(in_images, series, loaded, experiment.path.parent, 0.0)
    count = min(len(one) for one in series.values())
    tilt, apart = np.full((count, 2), np.nan), []
    for index in range(count):
        found = _level_frame(series, index, loaded, folder)
        if found is not None:
            tilt[index], by_camera = found
            apart.append(np.ptp(by_camera, axis=0) if len(by_camera) > 1 else np.full(2, np.nan))
        if progress:
            progress(index + 1, count)
    if not apart:
        raise RigError(
            "no frame shows the horizon in all cameras: only frames that do can be turned level one by one"
        )
    loaded.save(folder / "rig.yaml")
    note = yaml.safe_load(experiment.path.read_text(encoding="utf-8"))
    note = {key: note[key] for key in KEPT if key in note}
    images = {name: {"images": f"{name}/img_{{frame:05d}}.tif"} for name in loaded}
    path = folder / "experiment.yaml"
    text = yaml.safe_dump({**note, "cameras": images, "rig": "rig.yaml"}, sort_keys=False)
    write_text(path, text, NEW_FILE)
    # the mean of two cameras has half of what they differ by
    of_images = 0.5 * np.sqrt(np.mean(np.square(apart)))
    of_air = REFRACTION_STD * max(dip(camera.centre[2]) for camera in loaded.cameras.values())
    std = float(np.degrees(np.hypot(of_images, of_air)))
    return PlatformMotion(path, loaded, np.degrees(tilt), std)


def sway(images: Sequence[NDArray[Any]], camera: Camera) -> float:
    """Rms of the roll and pitch of a camera, degrees, from its horizon in images; NaN in fewer than three."""
    lines = [find_horizon([image], camera) for image in images]
    rays = [sight_lines(camera, line) @ camera.R for line in lines if line is not None]
    if len(rays) < MIN_HORIZONS:
        return float("nan")
    tilts = [_tilt(one, np.zeros(len(one))) for one in rays]
    return float(np.degrees(np.sqrt(np.var(tilts, axis=0).max())))


def _level_frame(
    series: Mapping[str, FrameSeries], index: int, rig: Rig, folder: Path
) -> tuple[Array, Array] | None:
    """Tilt (2,) of a frame, and by camera (cameras, 2), rad; its images are written turned level."""
    images = {name: series[name].read_uncovered(index) for name in rig}
    rays = {}
    for name, image in images.items():
        points = None if image is None else find_horizon([image], rig[name])
        if points is None:
            return None
        rays[name] = sight_lines(rig[name], points) @ rig[name].R
    dips = {name: dip(rig[name].centre[2]) for name in rig}
    own = np.array([_tilt(rays[name], np.full(len(rays[name]), dips[name])) for name in rays])
    count = [len(one) for one in rays.values()]
    tilt = _tilt(np.concatenate([*rays.values()]), np.repeat([*dips.values()], count))
    focal = min(camera.fy for camera in rig.cameras.values())
    if np.abs(own - tilt).max() * focal > 3.0 * MAX_MISFIT:
        return None  # the cameras show different edges
    turn = _level_turn(tilt)
    middle = np.mean([camera.centre for camera in rig.cameras.values()], axis=0)
    for name, image in images.items():
        camera = rig[name]
        centre = middle + turn @ (camera.centre - middle)
        rotation = camera.R @ turn.T
        moved = replace(camera, rotation=rotation, translation=-rotation @ centre)
        path = folder / name / f"img_{series[name].first + index:05d}.tif"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, redrawn(np.asarray(image), moved, camera))
    return tilt, own


def _tilt(rays: Array, dips: Array) -> Array:
    """Tilt about x and y, rad, of a frame whose unit rays (n, 3) go to the horizon, dipped by (n,), rad."""
    tilt, weight = np.zeros(2), np.ones(len(rays))
    for _ in range(8):
        up = _level_turn(tilt)[2]
        miss = rays @ up + np.sin(dips)
        # d up / d tilt at small angles
        design = np.column_stack([rays[:, 1], -rays[:, 0]])
        root = np.sqrt(weight)
        tilt = tilt - np.linalg.lstsq(root[:, None] * design, root * miss, rcond=None)[0]
        spread = 1.5 * float(np.median(np.abs(miss))) + 1e-12
        weight = np.minimum(1.0, 2.0 * spread / np.maximum(np.abs(miss), 1e-12))
    return tilt


def _level_turn(tilt: Array) -> Array:
    """Rotation (3, 3) from a frame tilted about x and y to the level one, without yaw."""
    return rotation_about([*tilt, 0.0])


def redrawn(image: NDArray[Any], taken: Camera, drawn: Camera) -> NDArray[Any]:
    """An image (row, column) of one camera as another, near it, would have taken it of z = 0 and the sky."""
    width, height = drawn.size
    a, b = drawn.tangents(np.arange(float(width)), np.arange(float(height))[:, None])
    ray = np.stack([a, b, np.ones_like(a)], -1) @ drawn.R
    with np.errstate(divide="ignore"):
        far = np.where(ray[..., 2] < 0.0, np.minimum(-drawn.centre[2] / ray[..., 2], FAR), FAR)
    x, y, z = np.moveaxis(drawn.centre + far[..., None] * ray, -1, 0)
    X, Y = (np.nan_to_num(v, nan=-1e4).astype(np.float32) for v in taken.project(x, y, z))
    grey = float(np.median(image))
    out = cv2.remap(
        image.astype(np.float32), X, Y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=grey
    )
    if image.dtype.kind == "f":
        return np.asarray(out, image.dtype)
    top = np.iinfo(image.dtype).max
    return np.asarray(np.clip(np.rint(out), 0, top), image.dtype)
