"""Doctests run in a folder that holds two small cubes."""

from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="session")
def example_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``cube.zarr``, ten steps in chunks of four, and ``sea.zarr``, 51 s of waves."""
    from wavefield.store.layout import StoreLayout, create_store
    from wavefield.store.recipe import Recipe
    from wavefield.store.write_cube import write_chunk
    from wavefield.variables import CUBE_FIELDS, FrameStatus

    folder = tmp_path_factory.mktemp("examples")
    layout = StoreLayout(10, 4, ("left", "right"), 0)
    recipe = Recipe("basin", {}, (0, 10), 20.0, {}, {}, {})
    create_store(folder / "cube.zarr", recipe, np.arange(4) * 0.1, np.arange(3) * 0.1, layout, {})
    for start, stop in layout.chunks():
        fields = {name: np.ones((stop - start, 3, 4), np.float32) for name in CUBE_FIELDS}
        write_chunk(folder / "cube.zarr", start, fields, np.full(stop - start, FrameStatus.DONE), {})

    layout = StoreLayout(1024, 256, ("left", "right"), 0)
    recipe = Recipe("basin", {}, (0, 1024), 20.0, {}, {}, {})
    create_store(folder / "sea.zarr", recipe, np.arange(20) * 0.05, np.arange(16) * 0.05, layout, {})
    for start, stop in layout.chunks():
        fields = {name: np.ones((stop - start, 16, 20), np.float32) for name in CUBE_FIELDS}
        fields |= waves(np.arange(start, stop) * 0.05)
        write_chunk(folder / "sea.zarr", start, fields, np.full(stop - start, FrameStatus.DONE), {})
    return folder


def waves(time: np.ndarray) -> dict[str, np.ndarray]:
    """Free deep-water waves of 1.5 to 3 Hz on a current of 5 cm/s along x, (time, y, x)."""
    rng = np.random.default_rng(0)
    frequency, angle = rng.uniform(1.5, 3, 200), rng.uniform(0, np.pi, 200)
    sigma = 2 * np.pi * frequency
    kx, ky = sigma**2 / 9.81 * np.stack([np.cos(angle), np.sin(angle)])
    omega = sigma + 0.05 * kx
    x, y = np.arange(20) * 0.05, np.arange(16)[:, None] * 0.05
    place = np.exp(1j * (kx[:, None, None] * x + ky[:, None, None] * y))
    phase = np.exp(2j * np.pi * rng.random(200) - 1j * np.outer(time, omega))
    of_z = {"z": 1, "z_t": -1j * omega, "w": -1j * sigma, "u": 9.81 / sigma * kx, "v": 9.81 / sigma * ky}
    out = {n: np.tensordot(1e-3 * phase / frequency**2 * each, place, 1).real for n, each in of_z.items()}
    return {name: np.float32(field + 0.05 * (name == "u")) for name, field in out.items()}


@pytest.fixture(autouse=True)
def _beside_the_example(request: pytest.FixtureRequest) -> None:
    """Let every doctest begin in this folder."""
    if isinstance(request.node, pytest.DoctestItem):
        request.getfixturevalue("monkeypatch").chdir(request.getfixturevalue("example_folder"))
