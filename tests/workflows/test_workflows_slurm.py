"""Runs in Slurm jobs, where a Slurm answers; workflows/one_node_slurm.sh starts one, as .ci/run does."""

import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
import xarray as xr
import yaml
from cube_cases import different

import wavefield as wf
from wavefield.errors import ExperimentError
from wavefield.execution.cluster import open_cluster
from wavefield.pipeline import Workflow, status

ROOT = Path(__file__).parents[2]
LIMITED = "limited"  # name of the jobs that end at their time limit, beside the other tests

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("slurm_there")]


def slurm(*command, **keywords):
    return subprocess.run(command, check=True, capture_output=True, text=True, **keywords).stdout.strip()


def wait_for(condition, patience=900.0):
    since = time.monotonic()
    while not condition():
        assert time.monotonic() - since < patience, "nothing happened for too long"
        time.sleep(0.3)  # each look is a process, beside the workers


def queue(*options):
    """Jobs that wait or run, but for those of the run at its time limit."""
    shown = slurm("squeue", "--noheader", "--format=%A %j", *options).split("\n")
    return [line.split()[0] for line in shown if line and not line.endswith(f" {LIMITED}")]


def steps_done(out):
    if not out.exists():
        return 0
    now = status(out)
    return now.steps - now.left


def write_workflow(folder, **more):
    """The workflow that is shipped, with jobs of the size that a test needs: two of one worker each."""
    data = yaml.safe_load((ROOT / "workflows" / "slurm.yaml").read_text())
    data |= {"workers": 2, "memory": "600 MB", "steps_per_block": 1}
    data["slurm"] |= {"cores": 1, "walltime": "00:10:00", "python": sys.executable, "queue": partition()}
    data["slurm"] |= more
    path = folder / "slurm.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


@pytest.fixture
def workflow(tmp_path):
    """The workflow file of a test."""
    return write_workflow(tmp_path)


def partition():
    """The one that jobs go to if they name none."""
    names = slurm("sinfo", "--noheader", "--format=%P").split()
    return next((name.rstrip("*") for name in names if name.endswith("*")), names[0])


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


def jobs(name):
    """Numbers of the jobs of that name that run."""
    return slurm("squeue", "--noheader", "--format=%A", f"--name={name}", "--states=RUNNING").split()


@pytest.mark.usefixtures("limited")  # so that its minute begins
def test_a_job_that_is_warned_puts_itself_back_and_one_that_is_cancelled_goes_on_when_asked(
    tank, reference, workflow, environment, tmp_path
):
    out = tmp_path / "cube.zarr"
    job = submit(tank, out, workflow, environment, tmp_path)
    wait_for(lambda: steps_done(out) >= 1)
    slurm("scancel", "--signal=USR1", job)  # as Slurm does before the time limit
    wait_for(lambda: "stopped by SIGUSR1" in (tmp_path / "job.out").read_text())
    before = steps_done(out)
    wait_for(lambda: steps_done(out) > before)  # it is back
    slurm("scancel", job)
    wait_for(lambda: not queue())  # its workers go with it
    done = steps_done(out)
    assert 2 <= done < status(out).steps
    assert (tmp_path / "job.out").read_text().count("nothing is lost") == 2
    submit(tank, out, workflow, environment, tmp_path)
    wait_for(lambda: status(out).complete and not queue())
    assert different(out, reference) == []
    assert not list(out.with_suffix(".jobs").glob(".dask*")), "credentials go with their run"


@contextmanager
def drained(node):
    """Let no new job on a node, where the user of the tests may do so."""
    change = ["scontrol", "update", f"nodename={node}"]
    allowed = subprocess.run([*change, "state=drain", "reason=test"], capture_output=True).returncode == 0
    try:
        yield allowed
    finally:
        if allowed:
            slurm(*change, "state=resume")


def start_run(tank, out, workflow):
    """A run of its own process, as on a login node."""
    command = [sys.executable, "-m", "wavefield.commands.cli", "run", str(tank), "-o", str(out)]
    return subprocess.Popen(
        [*command, "--workflow", str(workflow)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=out.parent,
    )  # fmt: skip


def end(process):
    process.kill()
    process.wait()
    process.stdout.close()


def test_worker_jobs_that_are_cancelled_are_asked_for_again_on_nodes_that_are_left(
    tank, reference, workflow, tmp_path, request
):
    out = tmp_path / "cube.zarr"
    process = start_run(tank, out, workflow)
    request.addfinalizer(lambda: end(process))
    wait_for(lambda: steps_done(out) >= 1)
    first = jobs("wavefield")
    node = slurm("squeue", "--noheader", "--format=%N", f"--jobs={first[0]}")
    with drained(node) as allowed:
        slurm("scancel", *first)
        wait_for(lambda: set(jobs("wavefield")) - set(first) or process.poll() is not None)
        if allowed and process.poll() is None:
            nodes = slurm("squeue", "--noheader", "--format=%N", "--name=wavefield", "--states=RUNNING")
            assert node not in nodes.split()
        text, _ = process.communicate(timeout=900)
    assert process.returncode == 0, text
    assert different(out, reference) == []
    wait_for(lambda: not queue())


@pytest.fixture(scope="module")
def limited(slurm_there, tank, tmp_path_factory):
    """A run whose workers hang until their time limit, which Slurm counts in minutes: other tests go on."""
    folder = tmp_path_factory.mktemp("limited")
    workflow = write_workflow(folder, walltime="00:01:00", job_name=LIMITED)
    out = folder / "cube.zarr"
    process = start_run(tank, out, workflow)
    try:
        wait_for(lambda: steps_done(out) >= 1 or process.poll() is not None)
        first = jobs(LIMITED)
        for worker in processes_of(first):
            worker.suspend()  # blocks that take longer than the job lives
        yield SimpleNamespace(out=out, process=process, first=first, done=steps_done(out))
    finally:
        end(process)


def test_workers_whose_time_limit_ends_them_in_the_middle_of_a_block_leave_the_same_cube(limited, reference):
    first, process = limited.first, limited.process
    wait_for(
        lambda: process.poll() is not None or not {state_of(job) for job in first} & {"RUNNING", "PENDING"}
    )
    text, _ = process.communicate(timeout=900)
    assert process.returncode == 0, text
    assert limited.done < status(limited.out).steps
    # the scheduler may miss a worker that hangs, and cancel its job, before Slurm counts the full minute
    assert "TIMEOUT" in {state_of(job) for job in first}
    assert different(limited.out, reference) == []
    wait_for(lambda: not slurm("squeue", "--noheader", f"--name={LIMITED}"))


def processes_of(jobs):
    """Processes of workers that run in some jobs on this machine."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.environ().get("SLURM_JOB_ID") in jobs and "python" in process.name():
                found.append(process)
    return found


def state_of(job):
    shown = subprocess.run(["scontrol", "show", "job", job], capture_output=True, text=True).stdout
    return dict(word.split("=", 1) for word in shown.split() if "=" in word).get("JobState", "")


def test_more_jobs_are_asked_for_while_work_waits_and_given_back_before_the_last_of_it_ends(
    workflow, tmp_path
):
    data = yaml.safe_load(workflow.read_text())
    data["workers"] = {"minimum": 1, "maximum": 2}
    seen, stop = [], threading.Event()

    def look():
        while not stop.wait(0.5):
            seen.append(len(queue("--name=wavefield")))

    with open_cluster(Workflow(**data), tmp_path / "logs") as map_unordered:
        looking = threading.Thread(target=look)
        done = []
        for item, _ in map_unordered(time.sleep, [2.0] * 8 + [15.0]):
            if not done:
                looking.start()
            done.append(item)
            if len(done) == 8:
                most, last = max(seen), len(seen)
        stop.set()
        looking.join()
    assert sorted(done) == [2.0] * 8 + [15.0]
    assert most == 2, "work waits, and there is one job"
    assert seen[last:][-1] == 1, "one item is left, and there are two jobs"
    wait_for(lambda: not queue())


def test_the_waves_that_slurm_jobs_find_are_those_of_one_process(reference, workflow, tmp_path):
    one, two = tmp_path / "one.zarr", tmp_path / "two.zarr"
    wf.analyze(reference, one, segment=8)
    wf.analyze(reference, two, workflow=workflow, segment=8)
    one, two = (xr.open_datatree(path, engine="zarr") for path in (one, two))
    for group in one.groups:
        for name, values in one[group].data_vars.items():
            assert np.asarray(values).tobytes() == np.asarray(two[group][name]).tobytes(), f"{group}/{name}"
    wait_for(lambda: not queue())


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"queue": "nowhere"}, "Slurm refuses the jobs of this run: invalid partition specified: nowhere"),
        (
            {"python": "/nowhere/python"},
            r"ended before its worker started.*\.err ends with: .*/nowhere/python: No such",
        ),
        (
            {"job_script_prologue": ["echo 'module: command not found' >&2; exit 1"]},
            r"ended before its worker started.*\.err ends with: module: command not found",
        ),
    ],
    ids=["wrong partition", "wrong Python", "no module"],
)
def test_jobs_that_never_work_are_named_with_the_reason(changes, sentence, workflow, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = yaml.safe_load(workflow.read_text())
    data["slurm"] |= changes
    with (
        open_cluster(Workflow(**data), tmp_path / "logs") as map_unordered,
        pytest.raises(ExperimentError, match=sentence),
    ):
        list(map_unordered(abs, [-1]))
    wait_for(lambda: not queue())
