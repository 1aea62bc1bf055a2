"""Write a simulated experiment as a laboratory would have it, with the exact truth apart."""

import itertools
import os
import warnings
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import xarray as xr
import yaml
import zarr

from wavefield.atomic_write import NEW_FILE, write_text
from wavefield.errors import ExperimentError
from wavefield.images import write_image
from wavefield.tank import beads as floating
from wavefield.tank import simulated_probes
from wavefield.tank.scene import Scene
from wavefield.tank.scene_parts import Texture
from wavefield.tank.tank import Tank
from wavefield.tank.truth import Truth
from wavefield.variables import CUBE_DIMS, annotate

Progress = Callable[[int, int], None]

_FIELDS = ("z", "z_t", "u", "v", "w", "z_rate", "z_start", "z_end", "dx", "dy", "dz")


def simulate(
    scene: Scene, directory: str | Path, progress: Progress | None = None, *, workers: int = 2
) -> Path:
    """Write the experiment of a scene.

    Parameters
    ----------
    scene : Scene
        What to simulate.
    directory : path
        Folder for it; it is made, and must be empty if it is there.
    progress : callable, optional
        Called as ``progress(done, total)`` when an image or a step of the truth is finished.
    workers : int, default 2
        Threads that draw images; the files do not depend on it.

    Returns
    -------
    Path
        The experiment file: ``experiment.yaml`` beside ``cam1/img_00000.tif`` ..., ``calib/cam1/tilt_0.tif``
        ..., ``calib/cam1/flat.tif``, ``probes.csv`` and ``scene.yaml``; and, apart, ``truth/rig.yaml`` (exact
        cameras), ``truth/truth.zarr`` (exact fields, one per step at mid-time) and ``truth/target.yaml``.

    Raises
    ------
    ExperimentError
        If the folder holds something already.

    Examples
    --------
    Two small frames of each camera, with two poses of the target.

    >>> import tempfile
    >>> small = {"rig": {"crop": 0.06}, "sea": {"shortest": 0.15}, "calibration": {"tilted": 1}}
    >>> scene = Scene.load("demo").with_(frames=2, **small)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = simulate(scene, Path(folder) / "tank")
    ...     images = sorted(path.name for path in (file.parent / "cam1").iterdir())
    >>> file.name, images
    ('experiment.yaml', ['img_00000.tif', 'img_00001.tif'])
    """
    directory = Path(directory)
    if os.path.lexists(directory) and (not directory.is_dir() or any(directory.iterdir())):
        raise ExperimentError(f"{directory} is not empty; give another folder or remove it")
    (directory / "truth").mkdir(parents=True, exist_ok=True)
    tank = Tank(scene)
    steps, names = scene.frames - 1, list(tank.rig)
    total = len(names) * (scene.frames + len(tank.target_poses)) + steps
    done = itertools.count(1)

    def report_progress() -> None:
        if progress is not None:
            progress(next(done), total)

    _write_notes(scene, tank, directory)
    with ThreadPoolExecutor(max(1, workers)) as pool:
        queue = _Queue(pool, 4 * max(1, workers), report_progress)
        for pose in tank.target_poses:
            for camera in names:
                queue.give(_draw_target, tank, directory, camera, pose)
        with_beads = not isinstance(scene.surface, Texture)
        for frame in range(scene.frames):
            beads = tank.population.frame(frame) if with_beads else None
            for camera in names:
                queue.give(_draw_frame, tank, directory, camera, frame, beads)
        queue.finish()
        if steps:
            _write_truth(tank, steps, directory / "truth" / "truth.zarr", pool, report_progress)
    return directory / "experiment.yaml"


@dataclass
class _Queue:
    """Images to be drawn by a pool, few at a time: beads of many frames would fill the memory."""

    pool: ThreadPoolExecutor
    most: int
    report_progress: Callable[[], None]
    waiting: deque[Future[None]] = field(default_factory=deque)

    def give(self, draw: Callable[..., None], *arguments: object) -> None:
        self.finish(leave=self.most - 1)
        self.waiting.append(self.pool.submit(draw, *arguments))

    def finish(self, leave: int = 0) -> None:
        while len(self.waiting) > leave:
            self.waiting.popleft().result()
            self.report_progress()


def _draw_target(tank: Tank, directory: Path, camera: str, pose: str) -> None:
    write_image(directory / "calib" / camera / f"{pose}.tif", tank.target_image(pose, camera))


def _draw_frame(
    tank: Tank, directory: Path, camera: str, frame: int, beads: floating.BeadField | None
) -> None:
    if beads is None:
        image = tank.render(frame, [camera])[camera]
    else:
        image = tank.photograph(beads, frame, [camera])[camera]
    write_image(directory / camera / f"img_{frame:05d}.tif", image)


def _write_truth(
    tank: Tank, steps: int, path: Path, pool: ThreadPoolExecutor, report_progress: Callable[[], None]
) -> None:
    """Write the exact fields in pieces of time, so that a long record needs little memory."""
    grid, rate = tank.scene.grid, tank.scene.frame_rate
    piece = 32
    for first in range(0, steps, piece):
        parts: list[Truth] = []
        for part in pool.map(tank.truth, range(first, min(first + piece, steps))):
            parts.append(part)
            report_progress()
        fields = {
            name: (CUBE_DIMS, np.stack([getattr(part, name) for part in parts]).astype(np.float32))
            for name in _FIELDS
        }
        coords = {
            "time": (np.arange(first, first + len(parts)) + 0.5) / rate,
            "y": grid.y_nodes,
            "x": grid.x_nodes,
        }
        dataset = annotate(xr.Dataset(fields, coords))
        for name in ("z", "z_t", "u", "v", "w"):
            dataset[name].attrs.pop("frames", None)  # z_t is one difference here, the others are exact
        if first == 0:
            dataset.attrs = {
                "title": f"exact fields of the simulated experiment {tank.scene.name}",
                "frame_rate": rate,
                "water_depth": tank.scene.sea.depth,
            }
            chunks = {name: {"chunks": (min(piece, steps), *grid.shape)} for name in _FIELDS}
            dataset.to_zarr(path, mode="w", encoding=chunks, consolidated=False, zarr_format=3)
        else:
            dataset.to_zarr(path, append_dim="time", consolidated=False)
    with warnings.catch_warnings():
        # one small file tells a reader everything; that it is an extension of Zarr 3 harms nobody
        warnings.simplefilter("ignore")
        zarr.consolidate_metadata(path)


def _write_notes(scene: Scene, tank: Tank, directory: Path) -> None:
    """Write everything that is not an image: the lab note, the scene, the probes, the exact cameras."""
    names = list(tank.rig)
    experiment = {
        "name": scene.name,
        "frame_rate": scene.frame_rate,
        "cameras": {name: {"images": f"{name}/img_{{frame:05d}}.tif"} for name in names},
        "calibration": {
            "target": _describe_target(scene),
            "tilted": "calib/{camera}/tilt_*.tif",
            "flat": "calib/{camera}/flat.tif",
        },
        **_pairing(tank),
        "grid": {"x": list(scene.grid.x), "y": list(scene.grid.y), "step": scene.grid.step},
        "water": _describe_water(scene),
        "probes": "probes.csv",
    }
    if not scene.probes.positions:
        del experiment["probes"]
    note = f"# A simulated experiment (scene {scene.name}). The exact answer is in truth/.\n"
    text = yaml.safe_dump(experiment, sort_keys=False, default_flow_style=None, width=100)
    write_text(directory / "experiment.yaml", note + text, NEW_FILE)
    write_text(directory / "scene.yaml", scene.to_yaml(), NEW_FILE)
    tank.rig.save(directory / "truth" / "rig.yaml")
    write_text(directory / "truth" / "target.yaml", _target_truth(tank), NEW_FILE)
    if scene.probes.positions:
        settings = scene.probes
        times = np.arange(int(scene.frames / scene.frame_rate * settings.rate) + 1) / settings.rate
        z = simulated_probes.record(tank.sea, settings.positions, times + scene.start)
        z += settings.noise * np.random.default_rng([scene.seed, 10]).standard_normal(z.shape)
        simulated_probes.write(directory / "probes.csv", times, settings.positions, z)


def _describe_water(scene: Scene) -> dict[str, float]:
    described = {"depth": scene.sea.depth} if np.isfinite(scene.sea.depth) else {}
    if scene.calibration.level:
        # z = 0 of a rig calibrated with this target is the target, not the water (nor the exact rig's z = 0)
        described["level"] = -scene.calibration.level
    return described


def _describe_target(scene: Scene) -> dict[str, object]:
    target = scene.calibration.target
    if target.kind == "strings":
        return {"kind": "strings", "mesh": target.mesh, "origin_mark": "disc", "x_mark": "small disc"}
    described: dict[str, object] = {"kind": target.kind, "mesh": target.mesh, "shape": list(target.shape)}
    # its middle lies at the tank's origin
    described["origin"] = [round(-0.5 * (n - 1) * target.mesh, 9) for n in target.shape]
    if target.kind == "dots":
        described["diameter"] = target.diameter
    return described


def _pairing(tank: Tank) -> dict[str, object]:
    """Which cameras work together: the most upright one is matched to the others."""
    names = list(tank.rig)
    if len(names) < 2:
        return {}
    upright = max(names, key=lambda name: -tank.rig[name].R[2, 2])
    others = [name for name in names if name != upright]
    return {
        "surface": {"pairs": [[upright, name] for name in others]},
        "velocity": {"cameras": others if len(others) > 1 else names},
    }


def _target_truth(tank: Tank) -> str:
    """Poses of the target, and the errors of its crossings."""
    data: dict[str, object] = {
        "meaning": "a point p of the target is at rotation p + origin, metres",
        "poses": {
            name: {"rotation": pose.rotation.tolist(), "origin": [float(v) for v in pose.origin]}
            for name, pose in tank.target_poses.items()
        },
    }
    offsets = tank.target_offsets
    if offsets is not None and np.any(offsets):
        data["node_offsets"] = offsets.round(7).tolist()
    return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)
