"""Runs in Slurm jobs, where a Slurm answers (workflows/one_node_slurm.sh starts one)."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cube_cases import different

from wavefield.cubes import status

ROOT = Path(__file__).parents[2]


def slurm_answers() -> bool:
    try:
        return subprocess.run(["sinfo", "--noheader"], capture_output=True, timeout=10).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


pytestmark = pytest.mark.skipif(
    not slurm_answers(), reason="no Slurm answers here; workflows/one_node_slurm.sh starts one"
)


def slurm(*command, **keywords):
    return subprocess.run(command, check=True, capture_output=True, text=True, **keywords).stdout.strip()


def wait_for(condition, patience=180.0):
    since = time.monotonic()
    while not condition():
        assert time.monotonic() - since < patience, "nothing happened for too long"
        time.sleep(0.1)


def steps_done(out):
    if not out.exists():
        return 0
    now = status(out)
    return now.steps - now.left


@pytest.fixture
def workflow(tmp_path):
    """Two jobs of one worker each."""
    path = tmp_path / "slurm.yaml"
    path.write_text(
        "cluster: slurm\nworkers: 2\nmemory: 500 MB\nsteps_per_block: 1\ndashboard: null\n"
        f"slurm: {{queue: cpu, cores: 1, walltime: '00:10:00', log_directory: '{tmp_path}', "
        f"python: '{sys.executable}'}}\n"
    )
    return path


@pytest.fixture
def environment():
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def submit(tank, out, workflow, environment, folder):
    """Submit the job that starts workers as jobs of their own; returns its number."""
    script = ROOT / "workflows" / "slurm_job.sh"
    return slurm(
        "sbatch", "--parsable", "--cpus-per-task=1", "--mem-per-cpu=500M", "--time=10",
        f"--output={folder}/job.out",
        str(script), str(tank), "-o", str(out), "--workflow", str(workflow),
        env=environment, cwd=folder,
    )  # fmt: skip


def test_a_job_that_is_cancelled_in_the_middle_goes_on(tank, reference, workflow, environment, tmp_path):
    out = tmp_path / "cube.zarr"
    job = submit(tank, out, workflow, environment, tmp_path)
    wait_for(lambda: steps_done(out) >= 2)
    slurm("scancel", job)
    wait_for(lambda: not slurm("squeue", "--noheader"))  # its workers go with it
    done = steps_done(out)
    assert 2 <= done < status(out).steps
    assert "nothing is lost" in (tmp_path / "job.out").read_text()
    submit(tank, out, workflow, environment, tmp_path)
    wait_for(lambda: status(out).complete and not slurm("squeue", "--noheader"))
    assert different(out, reference) == []


def test_worker_jobs_that_are_cancelled_are_asked_for_again(tank, reference, workflow, environment, tmp_path):
    out = tmp_path / "cube.zarr"
    command = [
        sys.executable,
        "-m",
        "wavefield.commands.cli",
        "run",
        str(tank),
        "-o",
        str(out),
        "--workflow",
        str(workflow),
    ]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=tmp_path
    )
    wait_for(lambda: steps_done(out) >= 1)
    slurm("scancel", "--name=wavefield")
    text, _ = process.communicate(timeout=180)
    assert process.returncode == 0, text
    assert different(out, reference) == []
    wait_for(lambda: not slurm("squeue", "--noheader"))
