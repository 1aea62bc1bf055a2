"""The small tank of the cubes' tests."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "cubes"))

from cube_cases import HERE, write_tank

from wavefield.cubes import run


@pytest.fixture(scope="session")
def tank(tmp_path_factory):
    """Experiment file of the small tank; not to be changed."""
    return write_tank(tmp_path_factory.mktemp("tank"))


@pytest.fixture(scope="session")
def reference(tank, tmp_path_factory):
    """Its cube from one uninterrupted run."""
    path = tmp_path_factory.mktemp("reference") / "cube.zarr"
    run(tank, out=path, workflow=HERE)
    return path
