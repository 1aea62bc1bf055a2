"""Cubes of smooth random fields, written through the store's own writer."""

import atexit
import shutil
import tempfile
from pathlib import Path

import numpy as np

from wavefield.store.layout import StoreLayout, create_store
from wavefield.store.preview import create_preview
from wavefield.store.read import open_group
from wavefield.store.recipe import Recipe
from wavefield.store.write_cube import write_chunk
from wavefield.variables import CUBE_FIELDS, FrameStatus, Quality

WAVES = ((3.0, 1.0, 0.006, 0.3), (-2.0, 4.0, 0.004, 1.1), (6.0, -5.0, 0.002, 2.0))  # kx, ky, amplitude, phase


def sea(t: np.ndarray, y: np.ndarray, x: np.ndarray) -> dict[str, np.ndarray]:
    """Return z, z_t, u, v, w of three long waves over (time, y, x)."""
    t, y, x = t[:, None, None], y[None, :, None], x[None, None, :]
    out = {
        name: np.zeros(np.broadcast_shapes(t.shape, y.shape, x.shape)) for name in ("z", "z_t", "u", "v", "w")
    }
    for kx, ky, a, phase in WAVES:
        k = np.hypot(kx, ky)
        omega = np.sqrt(9.81 * k)
        theta = kx * x + ky * y - omega * t + phase
        out["z"] += a * np.cos(theta)
        out["z_t"] += a * omega * np.sin(theta)
        out["w"] += a * omega * np.sin(theta)
        out["u"] += a * omega * kx / k * np.cos(theta)
        out["v"] += a * omega * ky / k * np.cos(theta)
    return {name: field.astype(np.float32) for name, field in out.items()}


def block_fields(t: np.ndarray, y: np.ndarray, x: np.ndarray, seed: int = 0) -> dict[str, np.ndarray]:
    """Return every variable of a cube for some steps: sea, noise, a corner out of view, a filled patch."""
    rng = np.random.default_rng(seed)
    out = sea(t, y, x)
    shape = out["z"].shape
    for name, size in (("z", 2e-4), ("u", 2e-3), ("v", 2e-3), ("w", 2e-3)):
        out[name] += rng.normal(0.0, size, shape).astype(np.float32)
        out[f"{name}_std"] = np.full(shape, size, np.float32)
    out["eps_y"] = rng.normal(0.0, 1e-4, shape).astype(np.float32)
    out["eps_piv"] = np.abs(rng.normal(0.0, 0.1, shape)).astype(np.float32)
    quality = np.full(shape, int(Quality.MEASURED), np.int64)
    ny, nx = shape[1:]
    quality[:, ny // 2 : ny // 2 + 3, nx // 4 : nx // 4 + 3] = Quality.FILLED | Quality.REJECTED_CORRELATION
    quality[:, :2, :3] = Quality.OUTSIDE
    for field in out.values():
        field[:, :2, :3] = np.nan
    out["quality"] = quality.astype(np.uint8)
    for name in CUBE_FIELDS:  # what other rooms have added since
        out.setdefault(name, np.full(shape, 1e-4, np.float32))
    return {name: out[name] for name in CUBE_FIELDS}


def create_cube(
    path: Path,
    steps: int = 120,
    ny: int = 16,
    nx: int = 20,
    block: int = 40,
    preview: bool = True,
    rig: dict[str, object] | None = None,
    **attributes: object,
) -> StoreLayout:
    """Make an empty cube with steps at 20 Hz and nodes 5 cm apart around the origin."""
    x, y = 0.05 * (np.arange(nx) - (nx - 1) / 2), 0.05 * (np.arange(ny) - (ny - 1) / 2)
    recipe = Recipe("sea of three waves", {}, (0, steps), 20.0, {}, rig or {}, {})
    layout = StoreLayout(steps, block, ("cam1", "cam2", "cam3"), 0)
    create_store(path, recipe, x, y, layout, {"water_depth": 0.7} | attributes)
    if preview:
        create_preview(open_group(path))
    return layout


def write_cube_block(path: Path, start: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Write the block that begins at a step; return its fields."""
    group = open_group(path)
    time, y, x = (np.asarray(group[name][:]) for name in ("time", "y", "x"))
    stop = min(start + int(group.attrs["steps_per_block"]), time.size)
    fields = block_fields(time[start:stop], y, x, seed + start)
    write_chunk(path, start, fields, np.full(stop - start, FrameStatus.DONE, np.uint8), {})
    return fields


_MADE: dict[object, tuple[Path, dict[str, np.ndarray]]] = {}  # cubes by name and sizes, to be copied


def make_cube(path: Path, **sizes: object) -> dict[str, np.ndarray]:
    """Make a complete cube, or copy one that was made before; return its fields."""
    asked = path.name, *sorted(sizes.items())
    if "rig" in sizes:  # used once
        return _make_cube(path, **sizes)
    if asked not in _MADE:
        folder = Path(tempfile.mkdtemp())
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        _MADE[asked] = folder, _make_cube(folder / path.name, **sizes)
    folder, fields = _MADE[asked]
    shutil.copytree(folder, path.parent, dirs_exist_ok=True)
    return {name: values.copy() for name, values in fields.items()}


def _make_cube(path: Path, **sizes: object) -> dict[str, np.ndarray]:
    layout = create_cube(path, **sizes)  # type: ignore[arg-type]
    parts = [write_cube_block(path, start) for start, _ in layout.chunks()]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
