"""Runs that are killed, interrupted or cut off from their scheduler; the cube is the same to the bit."""

import os
import signal
import socket
import subprocess
import sys
import time

import psutil
import pytest
from cube_cases import different

from wavefield.pipeline import Workflow, run, status

pytestmark = pytest.mark.slow
PATIENCE = 300.0  # seconds, on a busy machine


def start(tank, out, **workflow):
    path = out.parent / "workflow.yaml"
    path.write_text("".join(f"{name}: {value}\n" for name, value in workflow.items()))
    command = [sys.executable, "-m", "wavefield.commands.cli", "run", tank, "-o", out, "--workflow", path]
    return subprocess.Popen(
        [str(word) for word in command],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip


def wait_for_steps(out, steps, process):
    since = time.monotonic()
    while not out.exists() or (now := status(out)).steps - now.left < steps:
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() - since < PATIENCE, "nothing happened for too long"
        time.sleep(0.1)


def family_of(process):
    return psutil.Process(process.pid).children(recursive=True)


def workers_of(process):
    """Workers are forked from a child of the run."""
    return [child for child in family_of(process) if child.ppid() != process.pid]


def gone(processes):
    return not psutil.wait_procs(processes, timeout=30)[1]


LOCAL = {"cluster": "local", "workers": 2, "steps_per_block": 1}


def test_a_killed_run_leaves_no_process_and_a_killed_worker_costs_its_chunk(tank, reference, tmp_path):
    out = tmp_path / "cube.zarr"
    first = start(tank, out, **LOCAL)
    wait_for_steps(out, 2, first)
    family = family_of(first)
    first.kill()
    first.communicate()
    assert gone(family)
    done = status(out)
    assert 0 < done.left < done.steps

    second = start(tank, out, **LOCAL)
    wait_for_steps(out, done.steps - done.left + 1, second)
    workers_of(second)[0].kill()
    text, _ = second.communicate(timeout=PATIENCE)
    assert second.returncode == 0, text
    assert "Traceback" not in text
    assert different(out, reference) == []


def test_ctrl_c_on_a_terminal_stops_at_once_without_a_traceback(tank, reference, tmp_path):
    out = tmp_path / "cube.zarr"
    process = start(tank, out, **LOCAL)
    wait_for_steps(out, 2, process)
    family = family_of(process)
    os.killpg(process.pid, signal.SIGINT)
    text, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode != 0
    assert "nothing is lost, and the same command resumes" in text
    assert "Traceback" not in text
    assert "leaked" not in text
    assert gone(family)
    assert different(out, reference, slice(0, 1)) == []


@pytest.mark.parametrize("children", [1, 2, 4])
def test_ctrl_c_while_the_workers_start_prints_no_traceback(tank, tmp_path, children):
    process = start(tank, tmp_path / "cube.zarr", **LOCAL)
    since = time.monotonic()
    while len(family_of(process)) < children and time.monotonic() - since < PATIENCE:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    text, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode != 0
    assert "Traceback" not in text
    assert "Error" not in text


def test_a_scheduler_that_is_lost_ends_the_run_and_the_cube_is_completed_later(tank, reference, tmp_path):
    out = tmp_path / "cube.zarr"
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--no-dashboard"]
    scheduler = subprocess.Popen([*dask, "--port", str(port)], **quiet)
    dask = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"]
    worker = subprocess.Popen([*dask, "--no-nanny", "--death-timeout", "60"], **quiet)
    try:
        process = start(tank, out, cluster="address", address=address, workers=1, steps_per_block=2)
        wait_for_steps(out, 2, process)
        scheduler.kill()
        text, _ = process.communicate(timeout=PATIENCE)
    finally:
        for one in (worker, scheduler):
            one.kill()
            one.wait()
    assert process.returncode == 1, text
    assert "the scheduler was lost" in text
    assert not status(out).complete
    run(tank, out=out, workflow=Workflow(cluster="none", steps_per_block=2))
    assert different(out, reference) == []
