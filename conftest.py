"""Doctests run in a folder that holds a small cube."""

from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="session")
def example_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``cube.zarr``: ten steps in chunks of four."""
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
    return folder


@pytest.fixture(autouse=True)
def _beside_the_example(request: pytest.FixtureRequest) -> None:
    """Let every doctest begin in this folder."""
    if isinstance(request.node, pytest.DoctestItem):
        request.getfixturevalue("monkeypatch").chdir(request.getfixturevalue("example_folder"))
