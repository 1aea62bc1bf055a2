"""Path-traced images of a seeded tank with exact truth: rows ``tank``, ``glare``, ``tank_small``.

The target lay on the water: by how much the beads at rest stand above it is stated as `bead_height`.
They are not part of the project: ``shared/data/path_traced`` beside it, or in $WAVEFIELD_SHARED. The rig is
calibrated from ``tank/calib`` and refined on ``rest`` by the commands that a user would give.
"""

import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from benchmarks.scenes import Case, cached
from wavefield.grid import Grid
from wavefield.rig import Rig

SHARED = Path(os.environ.get("WAVEFIELD_SHARED", Path(__file__).parents[2] / "shared"))
GRID = Grid((-0.41, 0.41), (-0.29, 0.29), 0.01)
CAMERAS = ("cam1", "cam2", "cam3")
FRAME_RATE = 20.0
EXPERIMENT = """\
name: {name}
frame_rate: {rate}
cameras:
{cameras}
calibration:
  target: {{kind: strings, mesh: 0.05, origin_mark: disc, x_mark: small disc}}
  tilted: "{data}/tank/calib/{{camera}}/tilt_*.png"
  flat: "{data}/tank/calib/{{camera}}/flat.png"
surface: {{pairs: [[cam3, cam1], [cam3, cam2]]}}
grid: {{x: [{x[0]}, {x[1]}], y: [{y[0]}, {y[1]}], step: {step}}}
water: {{depth: 0.70}}
"""


def folder() -> Path | None:
    """Where the images are; None if they are not there."""
    found = SHARED / "data" / "path_traced"
    return found if (found / "tank").is_dir() else None


def write_experiment(name: str, directory: Path) -> Path:
    """An experiment file for one of the records."""
    data = folder()
    cameras = "\n".join(f'  {c}: {{images: "{data}/{name}/{c}/img_{{frame:05d}}.png"}}' for c in CAMERAS)
    text = EXPERIMENT.format(
        name=name, rate=FRAME_RATE, cameras=cameras, data=data, x=GRID.x, y=GRID.y, step=GRID.step
    )
    path = directory / f"{name}.yaml"
    path.write_text(text)
    return path


@cache
def rig() -> Rig:
    """The cameras, calibrated and then refined on the water at rest."""
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        paths = {record: write_experiment(record, directory) for record in ("tank", "rest")}
        first, refined = cached("path_traced.yaml"), directory / "refined.yaml"
        commands: list[list[str | Path]] = [["refine", paths["rest"], "--rig", first, "-o", refined]]
        if not first.exists():
            commands.insert(0, ["calibrate", paths["tank"], "-o", first])
        for words in commands:
            command = [str(Path(sys.executable).with_name("wavefield")), *map(str, words)]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                raise SystemExit(f"{' '.join(command[1:])}: {done.stderr or done.stdout}")
        return Rig.load(refined)


def load(name: str) -> Case:
    """A record; two frames are one step; of more every step but the first and the last is compared.

    It ends there: its outer steps have but one frame on one side.
    """
    data = folder()
    assert data is not None
    frames: dict[str, list[np.ndarray | None]] = {}
    for camera in CAMERAS:
        paths = sorted((data / name / camera).glob("*.png"))
        frames[camera] = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in paths]
        if len(paths) == 2:
            frames[camera] = [None, *frames[camera], None]
        frames[camera] = [None, *frames[camera], None]
    with np.load(data / name / "truth.npz") as file:
        x, y = (np.searchsorted(file[a], n - 1e-9) for a, n in (("x", GRID.x_nodes), ("y", GRID.y_nodes)))
        exact = {key: file[key][:, y[:, None], x] for key in ("z", "u", "v", "w")}
    steps = range(len(exact["z"]))[1:-1] if len(exact["z"]) > 1 else range(1)
    truth = [{key: field[step] for key, field in exact.items()} for step in steps]
    return Case(rig(), GRID, FRAME_RATE, frames, truth)


def bead_height() -> float:
    """By how much beads at rest stand above the target, m, from the record of still water."""
    return round(float(rig().provenance["levelled"]["height_m"]), 5)
