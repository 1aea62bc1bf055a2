"""The small tank of the cubes' tests."""

import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "cubes"))

from cube_cases import HERE, write_tank

from wavefield.pipeline import run


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


def pytest_addoption(parser):
    parser.addoption(
        "--require-slurm", action="store_true", help="fail where no Slurm answers, rather than skip"
    )


def slurm_answers():
    try:
        return subprocess.run(["sinfo", "--noheader"], capture_output=True, timeout=10).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


@pytest.fixture(scope="session")
def slurm_there(request):
    """Skips where no Slurm answers, unless one must."""
    if not slurm_answers():
        if request.config.getoption("--require-slurm", default=False):
            pytest.fail("no Slurm answers")
        pytest.skip("no Slurm answers here; workflows/one_node_slurm.sh starts one")
