"""Write a simulated experiment as the files of a laboratory, with the exact fields in a separate folder."""

import itertools
import os
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr
import yaml
import zarr

from wavefield.atomic_write import write_text, writing
from wavefield.errors import ExperimentError
from wavefield.images import write_image
from wavefield.rig import Rig
from wavefield.tank.scene import Scene
from wavefield.tank.scene_parts import Sheet
from wavefield.tank.sea import Sea
from wavefield.tank.tank import GreyImage, Tank
from wavefield.tank.truth import Truth
from wavefield.variables import CUBE_DIMS, annotate

Progress = Callable[[int, int], None]
Drawing = Callable[[], GreyImage]

CHUNK_STEPS = 32  # steps of the exact fields that are computed and written at once
TASKS_PER_WORKER = 4  # images that wait to be drawn, per thread; their beads are in memory


def simulate(
    scene: Scene, directory: str | Path, progress: Progress | None = None, *, workers: int = 2
) -> Path:
    """Simulate a scene and write its experiment.

    Parameters
    ----------
    scene : Scene
        Settings of the simulated experiment.
    directory : path
        Folder to write into. It is made if it does not exist; otherwise it must be empty.
    progress : callable, optional
        Called as ``progress(done, total)`` when an image or a step of the exact fields is finished.
    workers : int, default 2
        Number of threads that draw images; the files do not depend on it.

    Returns
    -------
    Path
        The file ``experiment.yaml``. Next to it are images (``cam1/img_00000.tif``), target images
        (``calib/cam1/tilt_0.tif``, ``flat.tif``), ``probes.csv`` and ``scene.yaml``; the folder ``truth``
        holds the exact cameras, ``rig.yaml``, and the exact fields of every step, ``truth.zarr``.

    Raises
    ------
    ExperimentError
        If the folder is not empty.

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
    with writing(directory):
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
        _draw(_drawings(tank, directory), pool, TASKS_PER_WORKER * max(1, workers), report_progress)
        if steps:
            _write_truth(tank, steps, directory / "truth" / "truth.zarr", pool, report_progress)
    return directory / "experiment.yaml"


def _drawings(tank: Tank, directory: Path) -> Iterator[tuple[Path, Drawing]]:
    """Yield the path of each image below `directory`, and a function without arguments that draws it."""
    for pose in tank.target_poses:
        for camera in tank.rig:
            yield directory / "calib" / camera / f"{pose}.tif", partial(tank.target_image, pose, camera)
    for frame in range(tank.scene.frames):
        for camera in tank.rig:
            drawing = partial(tank.draw, camera, frame, tank.beads(camera, frame))
            yield directory / camera / f"img_{frame:05d}.tif", drawing


def _draw(
    drawings: Iterable[tuple[Path, Drawing]],
    pool: ThreadPoolExecutor,
    most: int,
    report_progress: Callable[[], None],
) -> None:
    """Draw and write images on the threads of `pool`, and call `report_progress` after each one.
    At most `most` images wait or are being drawn at once."""
    waiting: deque[Future[None]] = deque()
    for path, drawing in drawings:
        if len(waiting) == most:
            waiting.popleft().result()
            report_progress()
        waiting.append(pool.submit(lambda path, drawing: write_image(path, drawing()), path, drawing))
    for drawn in waiting:
        drawn.result()
        report_progress()


def _write_truth(
    tank: Tank, steps: int, path: Path, pool: ThreadPoolExecutor, report_progress: Callable[[], None]
) -> None:
    """Write the exact fields of `steps` steps to the Zarr store `path`, in chunks; report each step."""
    grid, rate = tank.scene.grid, tank.scene.frame_rate
    names = [field.name for field in fields(Truth) if field.name != "time"]
    for first in range(0, steps, CHUNK_STEPS):
        parts: list[Truth] = []
        for part in pool.map(tank.truth, range(first, min(first + CHUNK_STEPS, steps))):
            parts.append(part)
            report_progress()
        arrays = {name: np.stack([getattr(part, name) for part in parts]) for name in names}
        time = (np.arange(first, first + len(parts)) + 0.5) / rate
        dataset = annotate(
            xr.Dataset(
                {name: (CUBE_DIMS, values.astype(np.float32)) for name, values in arrays.items()},
                {"time": time, "y": grid.y_nodes, "x": grid.x_nodes},
            )
        )
        for name in ("z", "z_t", "u", "v", "w"):
            dataset[name].attrs.pop("frames", None)  # exact fields do not come from several frames
        if first == 0:
            dataset.attrs = {
                "title": f"exact fields of the simulated experiment {tank.scene.name}",
                "frame_rate": rate,
                "water_depth": tank.scene.sea.depth,
            }
            chunks = {name: {"chunks": (min(CHUNK_STEPS, steps), *grid.shape)} for name in names}
            dataset.to_zarr(path, mode="w", encoding=chunks, consolidated=False, zarr_format=3)
        else:
            dataset.to_zarr(path, append_dim="time", consolidated=False)
    with warnings.catch_warnings():
        # readers then open one small file; the warning that Zarr 3 does not specify it is harmless
        warnings.simplefilter("ignore")
        zarr.consolidate_metadata(path)


def _write_notes(scene: Scene, tank: Tank, directory: Path) -> None:
    """Write experiment.yaml, scene.yaml and truth/rig.yaml into `directory`.
    If there are wave probes, write probes.csv too, and at the open sea lenses.yaml."""
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
    }
    if places := {name: list(xy) for name, xy in scene.probes.positions.items()}:
        experiment["probes"] = {"file": "probes.csv", "places": places}
    if isinstance(scene.surface, Sheet):
        experiment["settings"] = {"preset": "sheet", "sheet_thickness": scene.surface.thickness}
    if not tank.target_poses:  # at sea only the lenses are known
        del experiment["calibration"], experiment["grid"]
        experiment |= {"rig": "lenses.yaml", "settings": {"preset": "texture"}}
        lenses = {
            name: replace(camera, rotation=np.eye(3), translation=np.zeros(3))
            for name, camera in tank.rig.cameras.items()
        }
        Rig(lenses, {"source": "lenses alone, without positions"}).save(directory / "lenses.yaml")
    note = f"# A simulated experiment (scene {scene.name}). The exact answer is in truth/.\n"
    text = yaml.safe_dump(experiment, sort_keys=False, default_flow_style=None, width=100)
    write_text(directory / "experiment.yaml", note + text)
    write_text(directory / "scene.yaml", scene.to_yaml())
    tank.rig.save(directory / "truth" / "rig.yaml")
    if scene.probes.positions:
        _write_probes(directory / "probes.csv", scene, tank.sea)


def _write_probes(path: Path, scene: Scene, sea: Sea) -> None:
    """Write a CSV table of time, s, and the noisy elevation at each wave probe, m."""
    settings = scene.probes
    times = np.arange(int(scene.frames / scene.frame_rate * settings.rate) + 1) / settings.rate
    x, y = np.array(list(settings.positions.values()), float).T
    z = np.array([sea.at(x, y, time, ("z",))["z"] for time in times + scene.start])
    z += settings.noise * np.random.default_rng([scene.seed, 10]).standard_normal(z.shape)
    rows = [",".join(f"{value:.6f}" for value in row) for row in np.column_stack([times, z])]
    write_text(path, "\n".join([",".join(["time", *settings.positions]), *rows]) + "\n")


def _describe_water(scene: Scene) -> dict[str, float]:
    described = {"depth": scene.sea.depth} if np.isfinite(scene.sea.depth) else {}
    if scene.calibration.level:
        # a rig calibrated with this target has z = 0 at the target, not at the water
        described["level"] = -scene.calibration.level
    return described


def _describe_target(scene: Scene) -> dict[str, object]:
    target = scene.calibration.target
    if target.kind == "strings":
        return {"kind": "strings", "mesh": target.mesh, "origin_mark": "disc", "x_mark": "small disc"}
    described: dict[str, object] = {"kind": target.kind, "mesh": target.mesh, "shape": list(target.shape)}
    # the middle of the target is the tank's origin
    described["origin"] = [round(-0.5 * (n - 1) * target.mesh, 9) for n in target.shape]
    if target.kind == "dots":
        described["diameter"] = target.diameter
    return described


def _pairing(tank: Tank) -> dict[str, object]:
    """Return the blocks `surface` and `velocity` of the experiment file; empty for a single camera.
    Surface pairs contain the most upright camera. Velocity uses the others, or both cameras of two."""
    names = list(tank.rig)
    if len(names) < 2:
        return {}
    upright = max(names, key=lambda name: -tank.rig[name].R[2, 2])
    others = [name for name in names if name != upright]
    return {
        "surface": {"pairs": [[upright, name] for name in others]},
        "velocity": {"cameras": others if len(others) > 1 else names},
    }
