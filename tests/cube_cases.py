"""A tank small enough to be measured in a second, and how to compare cubes."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import xarray as xr

from wavefield.pipeline import Workflow, open_cube
from wavefield.tank import Scene, Tank
from wavefield.variables import CUBE_DIMS, CUBE_FIELDS, FrameStatus, Quality, annotate

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


def linear_sea(
    steps: int = 48, shape: tuple[int, int] = (36, 44), rate: float = 20.0, seed: int = 1
) -> xr.Dataset:
    """A cube with the schema of a measured one, with noise, a filled patch, and nodes outside."""
    rng = np.random.default_rng(seed)
    ny, nx = shape
    time = (np.arange(steps) + 0.5) / rate
    x, y = 0.02 * (np.arange(nx) - nx // 2), 0.02 * (np.arange(ny) - ny // 2)
    t3, y3, x3 = np.meshgrid(time, y, x, indexing="ij")
    z, u, v, w, z_t, zx, zy = (np.zeros(t3.shape) for _ in range(7))
    for _ in range(12):
        k, angle, phase = rng.uniform(7, 40), rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)
        a, omega = 0.06 / k, np.sqrt(9.81 * k)
        arg = k * (np.cos(angle) * x3 + np.sin(angle) * y3) - omega * t3 + phase
        z += a * np.cos(arg)
        u += a * omega * np.cos(angle) * np.cos(arg)
        v += a * omega * np.sin(angle) * np.cos(arg)
        z_t += a * omega * np.sin(arg)
        zx -= a * k * np.cos(angle) * np.sin(arg)
        zy -= a * k * np.sin(angle) * np.sin(arg)
    w = z_t + u * zx + v * zy

    def noisy(field: np.ndarray, sigma: float) -> np.ndarray:
        return (field + sigma * rng.standard_normal(field.shape)).astype("float32")

    noises = {"z": (z, 1e-4), "z_t": (z_t, 1e-3), "u": (u, 1e-3), "v": (v, 1e-3), "w": (w, 2e-3)}
    fields = {name: noisy(*how) for name, how in noises.items()} | {"eps_y": noisy(0 * z, 1e-4)}
    fields["eps_piv"] = np.abs(noisy(0 * z, 0.05))
    for name, std in {"z": 1e-4, "u": 1e-3, "v": 1e-3, "w": 2e-3}.items():
        fields[f"{name}_std"] = np.abs(noisy(0 * z + std, 1e-5 if name == "z" else 1e-4))
    quality = np.full(t3.shape, int(Quality.MEASURED), "uint8")
    quality[:, 5:9, 10:14] = int(Quality.FILLED | Quality.REJECTED_CORRELATION)
    edge = np.ones(shape, bool)
    edge[2:-2, 2:-2] = False
    quality[:, edge] = int(Quality.OUTSIDE)
    for name, field in fields.items():
        fields[name] = np.where(edge, np.float32(np.nan), field)
    status = np.full(steps, int(FrameStatus.DONE), "uint8")
    status[7] = int(FrameStatus.DONE_WITH_FAULTS)
    cube = xr.Dataset(
        {name: (CUBE_DIMS, field) for name, field in fields.items()}
        | {"quality": (CUBE_DIMS, quality), "frame_status": ("time", status)},
        {"time": time, "y": y, "x": x, "path_frames": np.uint8(6)},
        {"frame_rate": rate, "water_depth": 0.7, "experiment": "linear sea", "wavefield_version": "test"},
    )
    return annotate(cube)
