"""Whether a Slurm answers here."""

import subprocess

import pytest


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
