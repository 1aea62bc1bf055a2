"""From the target images of an experiment to its rig, on several processes."""

import os
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import forkserver, get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.context import BaseContext
from pathlib import Path

import numpy as np

from wavefield.calibration.points import TargetPoints, read_points
from wavefield.calibration.result import Calibration
from wavefield.calibration.solve import calibrate
from wavefield.calibration.target import Target
from wavefield.calibration.target_finder import find_target
from wavefield.errors import CalibrationError, ExperimentError, FrameError
from wavefield.images import read_image
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.series.target_listing import find_views


def worker_context(preloaded: str) -> BaseContext:
    """How processes that find targets are started: on Linux forked from one that imports `preloaded`
    while the caller does, which halves the time for a few images.
    """
    if sys.platform != "linux":
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload([preloaded])
    forkserver.ensure_running()
    return context


def start_worker() -> None:
    """Settle this process, a worker: one thread, and no longer than the process that started it."""
    import cv2

    cv2.setNumThreads(1)
    leave_with_parent()


def leave_with_parent() -> None:
    """Let this worker end with the process that started it, however that ends (SIGTERM, SIGKILL)."""
    parent = parent_process()
    if parent is not None:
        sentinel = parent.sentinel

        def watch() -> None:
            wait([sentinel])
            os._exit(1)

        threading.Thread(target=watch, daemon=True).start()


TABLES = (".csv", ".txt", ".dat", "")  # endings of points found by another program
MAX_WORKERS = 8


@dataclass(frozen=True)
class TargetRig:
    """Result of calibrating an experiment."""

    calibration: Calibration  # The rig and how far it can be trusted
    views: dict[str, dict[str, TargetPoints]]  # Points found in the images
    images: dict[str, dict[str, Path]]  # The images
    notes: tuple[str, ...]  # Images without a target
    mesh: float  # Of the target, m


def one_note_each(unfound: Sequence[tuple[str, Path]]) -> list[str]:
    """Notes on images, each of which may begin with its path; those of one reason become one.

    Examples
    --------
    >>> a, b = Path("a/1.tif"), Path("b/2.tif")
    >>> one_note_each([("a/1.tif: no target", a), ("b/2.tif: no target", b)])
    ['no target (2 images: a/1.tif, b/2.tif)']
    >>> one_note_each([("a/1.tif: no target", a)])
    ['a/1.tif: no target']
    """
    by_reason: dict[str, list[Path]] = {}
    for words, path in unfound:
        by_reason.setdefault(words.removeprefix(f"{path}: "), []).append(path)
    if len(by_reason) == len(unfound):
        return [words for words, _ in unfound]
    return [
        f"{reason} ({len(paths)} image{'s' if len(paths) > 1 else ''}: "
        f"{', '.join('/'.join(path.parts[-2:]) for path in paths)})"
        for reason, paths in by_reason.items()
    ]


def _find_in_file(path: Path, target: Target, size: tuple[int, int] | None = None) -> TargetPoints | str:
    """Find the target in one image; a sentence where it cannot be found."""
    try:
        if is_table(path):
            return read_points(path, size, unit=target.mesh if target.kind == "points" else None)
        return find_target(read_image(path), target)
    except (CalibrationError, FrameError) as error:
        sentence = str(error)
        return sentence if str(path) in sentence else f"{path}: {sentence}"


def _frame_sizes(experiment: Experiment) -> dict[str, tuple[int, int]]:
    """Width and height of the images of each camera, px; none where there are no images yet."""
    try:
        return {name: (one.shape[1], one.shape[0]) for name, one in experiment.open_frames().items()}
    except (ExperimentError, FrameError):
        return {}


def placed_at(points: TargetPoints, height: float) -> TargetPoints:
    """Points of a target parallel to z = 0 at a known height (metres), its axes along those of the frame."""
    own = np.zeros(len(points)) if points.z is None else points.z
    return replace(points, z=own + height, placed=True)


def is_table(path: Path) -> bool:
    """Whether a file holds points in place of an image."""
    return path.suffix.lower() in TABLES


def calibrate_experiment(
    experiment: str | Path | Experiment,
    progress: Callable[[int, int], None] | None = None,
    solving: Callable[[int, int], None] | None = None,
) -> TargetRig:
    """Find the rig of an experiment from its target images.

    Parameters
    ----------
    experiment : path or Experiment
        With a calibration block.
    progress : callable, optional
        Called with (images done, all images).
    solving : callable, optional
        Called with (camera models fitted, all of them).

    Returns
    -------
    TargetRig

    Raises
    ------
    CalibrationError
        If target images are missing, or in none of them is the target found.

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.calibrate("experiment.yaml")  # doctest: +SKIP
    >>> found.calibration.usable, found.notes  # doctest: +SKIP
    (True, ())
    >>> found.calibration.rig.save("rig.yaml")  # doctest: +SKIP
    """
    if not isinstance(experiment, Experiment):
        experiment = Experiment.load(experiment)
    images = find_views(experiment)
    section = experiment.calibration
    assert section is not None
    poses = {pose for by_pose in images.values() for pose in by_pose}
    unknown = sorted(set(section.heights) - poses)
    if unknown:
        raise CalibrationError(
            f"{experiment.path}: heights names {', '.join(unknown)}; the poses are {', '.join(sorted(poses))}"
        )
    target = Target.from_dict(section.target, experiment.path)
    order = dict.fromkeys(pose for by_pose in images.values() for pose in by_pose)
    jobs = [
        (camera, pose, images[camera][pose]) for pose in order for camera in images if pose in images[camera]
    ]
    views: dict[str, dict[str, TargetPoints]] = {camera: {} for camera in images}
    unfound: list[tuple[str, Path]] = []  # why no target was found, and in which image
    frame_sizes = _frame_sizes(experiment) if any(is_table(p) for _, _, p in jobs) else {}
    workers = min(os.cpu_count() or 1, len(jobs), MAX_WORKERS)
    with ProcessPoolExecutor(workers, mp_context=worker_context(__name__), initializer=start_worker) as pool:
        sizes = [frame_sizes.get(camera) for camera, _, _ in jobs]
        found = pool.map(_find_in_file, [path for _, _, path in jobs], [target] * len(jobs), sizes)
        for done, ((camera, pose, _), points) in enumerate(zip(jobs, found, strict=True), 1):
            if isinstance(points, str):
                unfound.append((points, jobs[done - 1][2]))
            else:
                height = section.heights.get(pose)
                views[camera][pose] = points if height is None else placed_at(points, height)
            if progress:
                progress(done, len(jobs))
    notes = one_note_each(unfound)
    named = {
        camera: {pose: os.path.relpath(path, experiment.path.parent) for pose, path in by_pose.items()}
        for camera, by_pose in images.items()
    }
    calibration = calibrate(
        views,
        target,
        flat="flat" if section.flat else "",
        model=section.model or "auto",
        target_std=section.target_std,
        camera_distance=section.camera_distance,
        progress=solving,
    )
    source = {"experiment": experiment.name, "target": dict(section.target), "images": named}
    rig = Rig(calibration.rig.cameras, {**calibration.rig.provenance, **source})
    calibration = replace(calibration, rig=rig)
    return TargetRig(calibration, views, images, tuple(notes), target.mesh)
