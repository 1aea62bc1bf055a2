"""A tank small enough to be measured in a second, and how to compare cubes."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import xarray as xr

from wavefield.pipeline import Workflow, open_cube
from wavefield.tank import Scene, Tank
from wavefield.variables import CUBE_FIELDS

HERE = Workflow(cluster="none")
FOURS = Workflow(cluster="none", steps_per_block=4)
FRAMES = 17
KNOCKED = 6  # first frame of the wider tank after its cam1 was knocked


def write_tank(folder: Path, frames: int = FRAMES) -> Path:
    """Images of three cameras, a rig and an experiment file; returns the file."""
    from wavefield.images import write_image

    tank = Tank(Scene.load("demo").with_(rig={"crop": 0.12}, sea={"shortest": 0.15}))
    folder.mkdir(parents=True, exist_ok=True)
    tank.rig.save(folder / "rig.yaml")
    for number in range(frames):
        for camera, image in tank.render(number).items():
            write_image(folder / camera / f"img_{number:05d}.tif", image)
    path = folder / "experiment.yaml"
    path.write_text(
        f"""\
name: small-tank
frame_rate: {tank.scene.frame_rate}
cameras:
  cam1: {{images: "cam1/img_{{frame:05d}}.tif"}}
  cam2: {{images: "cam2/img_{{frame:05d}}.tif"}}
  cam3: {{images: "cam3/img_{{frame:05d}}.tif"}}
rig: rig.yaml
grid: {{x: [-0.04, 0.04], y: [-0.06, 0.06], step: 0.01}}
water: {{depth: 0.7}}
"""
    )
    return path


def far_apart(a, b, steps=slice(None), most=0.6) -> list[str]:
    """Fields in which two cubes differ by over so much of their uncertainty (rms), or 2.5 times it anywhere.

    Cubes of different frames are weighed by spectra and noise of different samples.
    """
    out = []
    for name in ("z", "u", "v", "w"):
        one, other, std = (
            np.asarray(c[q].isel(time=steps)) for c, q in ((a, name), (b, name), (b, f"{name}_std"))
        )
        apart = np.abs(one - other) / std
        alike = np.sqrt(np.nanmean(apart**2)) < most and np.nanmax(apart) < 2.5
        if not (alike and np.array_equal(np.isnan(one), np.isnan(other))):
            out.append(name)
    return out


COMPARED = (*CUBE_FIELDS, "frame_status")


@lru_cache(maxsize=4)
def _stored(path: Path, written: int) -> dict[str, np.ndarray]:
    with open_cube(path) as cube:
        return {name: np.asarray(cube[name]) for name in COMPARED}


def _values(cube: str | Path | xr.Dataset, steps: slice) -> dict[str, np.ndarray]:
    """Steps of a cube; one in a store is read once, as long as nothing there is written."""
    if isinstance(cube, xr.Dataset):
        return {name: np.asarray(cube[name].isel(time=steps)) for name in COMPARED}
    stored = _stored(Path(cube), max(file.stat().st_mtime_ns for file in Path(cube).rglob("*")))
    return {name: values[steps] for name, values in stored.items()}


def different(a, b, steps=slice(None)) -> list[str]:
    """Names of the variables in which two cubes differ in any bit of any value."""
    a, b = _values(a, steps), _values(b, steps)
    return [
        name for name in COMPARED if a[name].dtype != b[name].dtype or a[name].tobytes() != b[name].tobytes()
    ]
