"""The simulated scenes with which the measurement is compared, the truth of every step, and the errors.

By default half size: the middle half of every sensor at full resolution (512 x 512, 512 x 512, 1216 x 864
px), 0.9 x 0.7 m. Full size (``crop`` of 1): the paper's cameras, 2 x 1.5 m. 1 px = 1.8 mm.
"""

import getpass
import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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
from wavefield.variables import Quality

cv2.setNumThreads(1)

PIXEL = 1.8e-3
MARGIN = 0.04  # nodes nearer to the edge of the common view are not compared, m
FRAMES, MIDDLE = 8, 3  # frames drawn of each scene: three steps with two on either side; the middle one
HALF_FIELD = 0.45, 0.35  # of the nodes, m, where half of every sensor is read out
FULL_FIELD = 1.0, 0.75
BRIGHT = {"brightness": 110.0}
SMALL_TARGET = {"kind": "strings", "mesh": 0.05, "origin_disc": 0.022, "x_disc": 0.014, "half": 14}

NAMES = ("z", "u", "v", "w")
Array = NDArray[np.float64]
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


def rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


@dataclass
class Score:
    """Errors gathered over steps and seeds, px of 1.8 mm (velocities times the step's length).

    ``error`` and ``std`` of z, u, v, w: of nodes flagged as measured; ``filled``, ``filled_std``: of
    the others; ``nodes``: all that are compared.
    """

    error: dict[str, list[Array]] = field(default_factory=lambda: {n: [] for n in NAMES})
    std: dict[str, list[Array]] = field(default_factory=lambda: {n: [] for n in NAMES})
    filled: dict[str, list[Array]] = field(default_factory=lambda: {n: [] for n in NAMES})
    filled_std: dict[str, list[Array]] = field(default_factory=lambda: {n: [] for n in NAMES})
    nodes: int = 0
    measured: int = 0
    missing: int = 0

    def add(self, case: Case, cube: Mapping[str, NDArray[Any]]) -> None:
        """Add every step of a cube."""
        for step, truth in enumerate(case.truth):
            compared = inside(case, truth["z"])
            measured = (cube["quality"][step] & Quality.MEASURED) > 0
            self.nodes += int(compared.sum())
            self.measured += int((compared & measured).sum())
            self.missing += int((compared & ~np.isfinite(cube["z"][step])).sum())
            for name in NAMES:
                scale = (1.0 if name == "z" else 1.0 / case.frame_rate) / PIXEL
                error = (np.asarray(cube[name][step], float) - truth[name]) * scale
                std = np.asarray(cube[f"{name}_std"][step], float) * scale
                for where, errors, stds in (
                    (compared & measured, self.error, self.std),
                    (compared & ~measured & np.isfinite(error), self.filled, self.filled_std),
                ):
                    errors[name].append(error[where])
                    stds[name].append(std[where])

    def rms(self, name: str, filled: bool = False) -> float:
        return rms(np.concatenate((self.filled if filled else self.error)[name]))

    def fractions(self, name: str, filled: bool = False) -> tuple[float, float, float]:
        """Per cent of the errors within one and two standard uncertainties, and beyond three."""
        errors, stds = (self.filled, self.filled_std) if filled else (self.error, self.std)
        error, std = np.abs(np.concatenate(errors[name])), np.concatenate(stds[name])
        if not error.size:
            return (float("nan"),) * 3
        within = [100.0 * float(np.mean(error <= n * std)) for n in (1, 2, 3)]
        return within[0], within[1], 100.0 - within[2]

    def wrong(self, times: float = 5.0) -> float:
        """Per cent of the compared nodes that are flagged as measured and off by more than so many std."""
        off = [
            ~(np.abs(np.concatenate(self.error[name])) <= times * np.concatenate(self.std[name]))
            for name in NAMES
        ]
        return 100.0 * float(np.sum(np.any(off, axis=0))) / max(self.nodes, 1)

    def cells(self, filled: bool = False) -> list[str]:
        """Cells of a row: z; u, v, w; nodes measured; within one std; measured and wrong by five std."""
        z, *moved = (f"{rms:.{4 if rms < 2e-3 else 3}f}" for rms in (self.rms(n, filled) for n in NAMES))
        within = ", ".join(f"{self.fractions(name, filled)[0]:.0f}" for name in NAMES)
        measured = "" if filled else f"{100 * self.measured / max(self.nodes, 1):.1f} %"
        wrong = "" if filled else f"{self.wrong():.2f} %"
        return [z, ", ".join(moved), measured, f"{within} %", wrong]

    def __str__(self) -> str:
        """What a row of the table does not show."""
        shares = np.array([self.fractions(name) for name in NAMES]).T
        two, three = (" ".join(f"{share:.1f}" for share in shares[k]) for k in (1, 2))
        missing = 100 * self.missing / max(self.nodes, 1)
        return f"within 2 std {two}, beyond 3 std {three} % (z u v w); no value {missing:.2f} %"
