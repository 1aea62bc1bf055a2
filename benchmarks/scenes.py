"""The simulated scenes with which the measurement is compared, with the truth of every step.

By default half size: the middle half of every sensor at full resolution (512 x 512, 512 x 512, 1216 x 864
px), 0.9 x 0.7 m. Full size (``crop`` of 1): the paper's cameras, 2 x 1.5 m. 1 px = 1.8 mm.
"""

import getpass
import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import wavefield
from wavefield.calibration import Target, calibrate, find_target
from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Settings, measure
from wavefield.rig import Rig
from wavefield.tank import Scene, Tank

cv2.setNumThreads(1)

PIXEL = 1.8e-3
MARGIN = 0.04  # nodes nearer to the edge of the common view are not compared, m
FRAMES, MIDDLE = 8, 3  # frames drawn of each scene: three steps with two on either side; the middle one
HALF_FIELD = 0.45, 0.35  # of the nodes, m, where half of every sensor is read out
FULL_FIELD = 1.0, 0.75
BRIGHT = {"brightness": 110.0}
SMALL_TARGET = {"kind": "strings", "mesh": 0.05, "origin_disc": 0.022, "x_disc": 0.014, "half": 14}

Fields = Mapping[str, NDArray[Any]]

# name: (the tank's preset, what differs)
SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "random": ("full", {}),
    "light": ("full", {"light": {"gain": {"cam1": 0.4, "cam2": 2.0}, "flicker": 0.3}}),
    "steep": ("steep", {"surface": BRIGHT}),
    "low_light": ("low_light", {}),
    "gaps": ("gaps", {}),
    "rest": ("rest", {"surface": BRIGHT}),
    "texture": ("texture", {"surface": {"carried": True}}),
    "noisy": ("noisy", {"surface": BRIGHT}),
}


@dataclass(frozen=True)
class Case:
    """Frames of a record with their ``truth`` per step, from the third frame on."""

    rig: Rig
    grid: Grid
    frame_rate: float
    frames: Mapping[str, Sequence[NDArray[Any] | None]]
    truth: Sequence[Fields]


def scene(name: str, seed: int, crop: float = 0.5, **changes: Any) -> Scene:
    """A scene of the benchmarks with a part ``crop`` of every sensor; ``changes`` as for `Scene.with_`."""
    preset, own = SCENES[name]
    x, y = FULL_FIELD if crop == 1 else (round(2 * crop * half, 2) for half in HALF_FIELD)
    size = {"rig": {"scale": 1.0, "crop": crop}, "grid": {"x": (-x, x), "y": (-y, y), "step": 0.01}}
    return Scene.load(preset).with_(frames=FRAMES, seed=seed, **size).with_(**own).with_(**changes)


def draw(described: Scene, rig: Rig) -> Case:
    """The frames of a scene and the truth of its steps with two frames on either side."""
    tank = Tank(described)
    images = [tank.render(k) for k in range(described.frames)]
    frames = {name: [image[name] for image in images] for name in rig}
    return Case(rig, described.grid, described.frame_rate, frames, truths(tank))


def truths(tank: Tank) -> list[Fields]:
    """z, z_t (m, m/s), u, v, w (m/s), each (ny, nx), of the steps with two frames on either side."""
    out = []
    for step in range(2, tank.scene.frames - 3):
        exact = vars(tank.truth(step))
        moved = {"w_chord": exact["dz"] * tank.scene.frame_rate}
        out.append({k: exact[k] for k in ("z", "z_t", "u", "v", "w", "z_start", "z_end")} | moved)
    return out


@cache
def calibrated() -> Rig:
    """The cameras, half size, calibrated from images of the target; kept for the next run of this code."""
    path = cached("half.yaml")
    if not path.exists():
        _calibrate().save(path)
    return Rig.load(path)


def cached(name: str) -> Path:
    """A file in a folder of this version of calibration, rig and tank."""
    rooms = [Path(wavefield.__file__).parent / room for room in ("calibration", "rig", "tank")]
    files = sorted(p for room in rooms for p in room.rglob("*") if p.suffix in (".py", ".yaml"))
    code = hashlib.sha256(b"".join(p.read_bytes() for p in [Path(__file__), *files])).hexdigest()[:16]
    folder = Path(tempfile.gettempdir()) / f"wavefield-benchmarks-{getpass.getuser()}" / code
    folder.mkdir(parents=True, exist_ok=True)
    return folder / name


def _calibrate() -> Rig:
    tank = Tank(scene("random", 5, calibration={"target": SMALL_TARGET}))
    mesh = tank.scene.calibration.target.mesh
    strings = Target.from_dict(
        {"kind": "strings", "mesh": mesh, "origin_mark": "disc", "x_mark": "small disc"}
    )
    views = {
        camera: {pose: find_target(tank.target_image(pose, camera), strings) for pose in tank.target_poses}
        for camera in tank.rig
    }
    result = calibrate(views, strings)
    if not result.usable:
        raise SystemExit(f"calibration is not usable: {result.problems}")
    return result.rig


def reconstruct(
    case: Case, settings: Settings, departures: NDArray[np.floating] | None = None
) -> dict[str, NDArray[Any]]:
    """The cube of a case, every step with two frames, or None, on either side; fields (steps, ny, nx).

    With the departures of the frames from even times, intervals, where they are stated.
    """
    geometry = GridGeometry(case.rig, case.grid, settings)
    return measure(case.frames, geometry, case.frame_rate, departures=departures)


def inside(case: Case, z: NDArray[Any], margin: float = MARGIN) -> NDArray[np.bool_]:
    """Nodes at least ``margin`` inside the edge of the common view, (ny, nx)."""
    step, n = case.grid.step, int(np.ceil(margin / case.grid.step)) + 2
    x, y = (
        nodes[0] + step * np.arange(-n, nodes.size + n) for nodes in (case.grid.x_nodes, case.grid.y_nodes)
    )
    padded = np.pad(z, n, mode="edge")
    visible = np.all(
        [camera.sees(*np.meshgrid(x, y), padded) for camera in case.rig.cameras.values()], axis=0
    )
    distance = cv2.distanceTransform(np.pad(visible, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    return np.asarray((distance * step > margin)[n:-n, n:-n])
