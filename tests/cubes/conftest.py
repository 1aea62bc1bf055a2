"""The small tank and its cube, made once."""

import shutil

import pytest
from cube_cases import HERE, write_tank

from wavefield.cubes import run


@pytest.fixture(scope="session")
def tank(tmp_path_factory):
    """Experiment file of the small tank; not to be changed."""
    return write_tank(tmp_path_factory.mktemp("tank"))


@pytest.fixture
def own_tank(tank, tmp_path):
    """A copy of it that a test may spoil."""
    shutil.copytree(tank.parent, tmp_path / "tank")
    return tmp_path / "tank" / "experiment.yaml"


@pytest.fixture(scope="session")
def reference(tank, tmp_path_factory):
    """Its cube from one uninterrupted run in one block."""
    path = tmp_path_factory.mktemp("reference") / "cube.zarr"
    run(tank, out=path, workflow=HERE)
    return path
