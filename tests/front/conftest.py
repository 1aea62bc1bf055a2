"""A small cube with the schema of the real one, from an exact linear sea."""

import numpy as np
import pytest
import xarray as xr

from wavefield.variables import CUBE_DIMS, FrameStatus, Quality, annotate


def make_cube(
    steps: int = 48, shape: tuple[int, int] = (36, 44), rate: float = 20.0, seed: int = 1
) -> xr.Dataset:
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


@pytest.fixture(scope="session")
def cube() -> xr.Dataset:
    return make_cube()
