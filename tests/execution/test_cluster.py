"""Real worker processes and schedulers: killed, cut off, interrupted; the cube is the same to the bit.

Everything runs through the command line, in processes of its own.
"""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

import numpy as np
import psutil
import pytest
from cube_cases import different
from distributed import Client

from wavefield.errors import ExperimentError
from wavefield.execution import dask_cluster, pool
from wavefield.execution.cluster import open_cluster
from wavefield.execution.dask_settings import dask_settings
from wavefield.execution.slurm import count_jobs, slurm_cluster
from wavefield.execution.worker_settings import one_thread
from wavefield.pipeline import Workflow, run, status

PATIENCE = 300.0  # seconds, on a busy machine


def write_workflow(folder, **settings):
    path = folder / "workflow.yaml"
    path.write_text("".join(f"{name}: {value}\n" for name, value in settings.items()))
    return path


def start(tank, out, workflow):
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
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def wait_for(condition, process=None):
    since = time.monotonic()
    while not condition():
        if process is not None and process.poll() is not None:
            raise AssertionError(f"the run ended early: {process.stdout.read()}")
        if time.monotonic() - since > PATIENCE:
            raise AssertionError("nothing happened for too long")
        time.sleep(0.02)


def begun(out, steps=1):
    """Whether that many steps are done."""
    seen = None

    def condition():
        nonlocal seen
        ledger = out / "frame_status" / "c"
        if not ledger.exists() or (written := ledger.stat().st_mtime_ns) == seen:  # asked many times a second
            return False
        seen = written
        now = status(out)
        return now.steps - now.left >= steps

    return condition


def finish(process):
    text, _ = process.communicate(timeout=PATIENCE)
    return process.returncode, text


def workers_of(process):
    """Forked ones are children of the process that forks them."""
    return [
        child
        for child in psutil.Process(process.pid).children(recursive=True)
        if child.ppid() != process.pid or "spawn_main" in " ".join(child.cmdline())
    ]


def kill_all(process):
    """SIGKILL to a run and its workers."""
    family = [*psutil.Process(process.pid).children(recursive=True), psutil.Process(process.pid)]
    for member in family:
        member.kill()
    psutil.wait_procs(family, timeout=PATIENCE)
    process.communicate()


def test_workers_killed_and_runs_killed_leave_the_same_cube(tank, reference, tmp_path):
    out = tmp_path / "cube.zarr"
    workflow = write_workflow(tmp_path, cluster="local", workers=2, steps_per_block=1, dashboard="null")
    first = start(tank, out, workflow)
    wait_for(begun(out, 2), first)
    kill_all(first)
    done = status(out)
    assert 0 < done.left < done.steps

    second = start(tank, out, workflow)
    wait_for(begun(out, done.steps - done.left + 1), second)
    workers_of(second)[0].kill()  # its block is done again by another
    code, text = finish(second)
    assert code == 0, text
    assert status(out).complete
    assert different(out, reference) == []


def test_ctrl_c_on_a_terminal_stops_cleanly(tank, reference, tmp_path):
    """The terminal sends SIGINT to the run and all its workers at once."""
    out = tmp_path / "cube.zarr"
    workflow = write_workflow(tmp_path, cluster="local", workers=2, steps_per_block=1, dashboard="null")
    process = start(tank, out, workflow)
    wait_for(begun(out, 2), process)
    workers = workers_of(process)
    process.send_signal(signal.SIGINT)
    for worker in workers:
        with suppress(psutil.NoSuchProcess):  # the run, which was stopped first, may have ended it
            worker.send_signal(signal.SIGINT)
    code, text = finish(process)
    assert code != 0
    assert "nothing is lost, and the same command resumes" in text
    assert "Traceback" not in text
    assert not any(worker.is_running() for worker in workers)
    assert different(out, reference, slice(0, 1)) == []


@pytest.mark.parametrize("state", ["a process is there", "a worker is there", "the store is there"])
def test_ctrl_c_while_the_workers_start_prints_no_traceback(tank, tmp_path, state):
    out = tmp_path / "cube.zarr"
    workflow = write_workflow(tmp_path, cluster="local", workers=2, steps_per_block=1, dashboard="null")
    process = start(tank, out, workflow)
    reached = {
        "a process is there": lambda: psutil.Process(process.pid).children(),
        "a worker is there": lambda: workers_of(process),
        "the store is there": out.exists,
    }
    wait_for(reached[state], process)
    os.killpg(process.pid, signal.SIGINT)
    code, text = finish(process)
    assert code != 0
    assert "Traceback" not in text
    assert "NameError" not in text


@contextmanager
def scheduler_and_worker(folder):
    """A scheduler and a worker as separate processes that talk over TCP."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    options = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    scheduler = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "distributed.cli.dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            str(port),
            "--no-dashboard",
        ],
        **options,
    )
    worker = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "distributed.cli.dask_worker",
            address,
            "--nthreads",
            "1",
            "--no-dashboard",
            "--no-nanny",
            "--preload",
            "wavefield.pipeline.dask_preload",
            "--death-timeout",
            "60",
        ],
        **options,
    )
    try:
        yield address, scheduler, worker
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.wait()


def test_a_scheduler_over_tcp_and_its_death(tank, reference, tmp_path):
    out = tmp_path / "cube.zarr"
    with scheduler_and_worker(tmp_path) as (address, scheduler, _):
        workflow = write_workflow(tmp_path, cluster="address", address=address, workers=1, steps_per_block=2)
        process = start(tank, out, workflow)
        wait_for(begun(out, 2), process)
        scheduler.kill()
        code, text = finish(process)
    assert code == 1, text
    assert "the scheduler was lost" in text
    assert "run the same command again to go on" in text
    assert not status(out).complete
    run(tank, out=out, workflow=Workflow(cluster="none", steps_per_block=2))
    assert different(out, reference) == []


def test_no_scheduler_at_the_address(tank, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_cluster, "_SCHEDULER_TIMEOUT", "1s")
    workflow = Workflow(cluster="address", address="tcp://127.0.0.1:9")
    with pytest.raises(ExperimentError, match=r"no scheduler answers at tcp://127.0.0.1:9"):
        run(tank, out=tmp_path / "cube.zarr", workflow=workflow)


def test_a_job_that_is_cancelled_ends_at_once_whatever_it_is_at(tmp_path):
    """Its block would be written after the run reported its end."""
    with (
        scheduler_and_worker(tmp_path) as (address, _, worker),
        Client(address, timeout=PATIENCE, set_as_default=False) as client,
    ):
        future = client.submit(time.sleep, 60)
        wait_for(lambda: any(client.processing().values()))
        worker.terminate()
        assert worker.wait(timeout=30) == -signal.SIGTERM
        client.cancel([future], force=True)


def test_the_job_that_slurm_is_asked_for(tmp_path):
    workflow = Workflow(
        cluster="slurm",
        workers=32,
        memory="2 GB",
        slurm={
            "queue": "cpu",
            "cores": 8,
            "walltime": "04:00:00",
            "job_script_prologue": ["module load python"],
        },
        dashboard=None,
    )
    assert count_jobs(workflow) == (4, 4)
    with slurm_cluster(workflow, tmp_path, dask_settings(workflow)) as jobs:
        script = jobs.job_script()
    for line in (
        "#SBATCH -J wavefield",
        "#SBATCH -p cpu",
        "#SBATCH --cpus-per-task=8",
        "#SBATCH --mem=15G",
        "#SBATCH -t 04:00:00",
        "export OMP_NUM_THREADS=1",
        "export OPENBLAS_NUM_THREADS=1",
        "module load python",
        "export DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False",
        'export NUMBA_CACHE_DIR="${NUMBA_CACHE_DIR:-${TMPDIR:-/tmp}/wavefield-$(id -u)}"',
    ):
        assert line in script
    for option in ("--nworkers 8", "--nanny", "--nthreads 1", "--memory-limit 1.86GiB"):
        assert option in script


@pytest.mark.parametrize("given", [{}, {"cores": 1}, {"cores": 8, "processes": 1}])
def test_the_only_worker_of_a_slurm_job_is_started_without_another_process_beside_it(given, tmp_path):
    workflow = Workflow(cluster="slurm", slurm=given, dashboard=None)
    with slurm_cluster(workflow, tmp_path, dask_settings(workflow)) as jobs:
        assert "--no-nanny" in jobs.job_script()


def test_a_slurm_cluster_starts_from_a_helper_thread_and_leaves_ctrl_c_alone():
    """dask-jobqueue takes over Ctrl-C where it is imported, which fails outside the main thread."""
    program = (
        "import signal, sys, threading\n"
        "from wavefield.pipeline import Workflow\n"
        "from wavefield.execution.cluster import open_cluster\n"
        "before = signal.getsignal(signal.SIGINT)\n"
        "with open_cluster(Workflow(cluster='slurm')):\n"
        "    thread = threading.Thread(target=__import__, args=['dask_jobqueue.slurm'])\n"
        "    thread.start(), thread.join()\n"
        "    assert 'dask_jobqueue.slurm' in sys.modules\n"
        "    assert signal.getsignal(signal.SIGINT) is before\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_slurm_keywords_that_are_unknown_are_named(tmp_path):
    with pytest.raises(ExperimentError, match=r"the `slurm` block of the workflow: .*colour"):
        slurm_cluster(Workflow(cluster="slurm", slurm={"colour": "blue"}), tmp_path, {})


def settings_of(item):
    """How a worker is set."""
    import cv2

    return cv2.getNumThreads(), os.environ["OPENBLAS_NUM_THREADS"], signal.getsignal(signal.SIGINT).name


def test_workers_have_one_thread_and_the_caller_keeps_its_own(monkeypatch):
    import cv2

    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "4")
    before = dict(os.environ)
    with open_cluster(Workflow(cluster="local", workers=2)) as map_unordered:
        assert [result for _, result in map_unordered(settings_of, [0, 1])] == [(1, "1", "SIG_IGN")] * 2
    threads = cv2.getNumThreads()
    cv2.setNumThreads(2)
    with open_cluster(Workflow(cluster="none")) as map_unordered:
        assert [result for _, result in map_unordered(lambda _: cv2.getNumThreads(), [0])] == [1]
    assert cv2.getNumThreads() == 2
    with one_thread():
        assert cv2.getNumThreads() == 1
    cv2.setNumThreads(threads)
    assert dict(os.environ) == before


def die(item):
    """Ends its worker, each time or the first time."""
    times = item / "times"
    times.write_text(f"{times.read_text()}x" if times.exists() else "x")
    if item.name == "always" or times.read_text() == "x":
        os.kill(os.getpid(), signal.SIGKILL)
    return times.read_text()


def test_work_of_a_worker_that_dies_is_done_again_but_not_for_ever(tmp_path):
    items = [tmp_path / "once", tmp_path / "always"]
    for item in items:
        item.mkdir()
    with open_cluster(Workflow(cluster="local", workers=2)) as map_unordered:
        results = dict(map_unordered(die, items))
    assert results[items[0]] == "xx"
    assert "SIGKILL, 3 times" in str(results[items[1]])
    assert (items[1] / "times").read_text() == "xxx"


def take_memory(item):
    """Takes much more than a worker may."""
    kept = np.ones(60_000_000)
    time.sleep(20)
    return kept.size


def test_a_worker_beyond_its_memory_is_ended_with_a_word_about_it(monkeypatch):
    monkeypatch.setattr(pool, "CHECK_S", 0.1)
    with open_cluster(Workflow(cluster="local", workers=2, memory="400 MB")) as map_unordered:
        ((_, result),) = map_unordered(take_memory, [0])
    assert re.search(
        r"needs at least 0\.\d+ GB per worker, more than the workflow's `memory` of 0.4 GB", str(result)
    )


def fail(item):
    raise ValueError(f"item {item}")


def test_what_goes_wrong_in_a_worker_process_comes_back_with_its_place():
    with open_cluster(Workflow(cluster="local", workers=2)) as map_unordered:
        results = dict(map_unordered(fail, [1, 2]))
    assert {str(result) for result in results.values()} == {"item 1", "item 2"}
    assert "in fail" in results[1].__notes__[0]


def page_faults_of_temporaries(number):
    """Pages mapped anew while arrays of 2 MB come and go, by a worker."""
    import resource

    before = 0
    for k in range(40):
        if k == 20:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        np.ones(1 << 18)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(sys.platform != "linux", reason="other C libraries keep memory in ways of their own")
def test_workers_keep_freed_memory_for_the_next_step():
    """Dask has its workers hand it back, and then each of these arrays costs 512 page faults."""
    workflow = Workflow(cluster="local", workers=2, dashboard=None)
    with open_cluster(workflow) as map_unordered:
        faults = [result for _, result in map_unordered(page_faults_of_temporaries, range(4))]
    assert max(faults) < 512, faults


def configuration_of(item):
    """The configuration that a worker received."""
    import dask

    return dask.config.get(item)


def test_workers_are_not_watched_every_few_milliseconds():
    """Of a core, that took 4 % for each worker and 7 % for the run."""
    names = ["distributed.worker.profile.enabled", "distributed.admin.tick.interval", "array.slicing"]
    workflow = Workflow(cluster="local", workers=1, dashboard=":0", dask={"array": {"slicing": "mine"}})
    with open_cluster(workflow) as map_unordered:
        received = dict(map_unordered(configuration_of, names))
    assert received == dict(zip(names, [False, "1s", "mine"]))


def test_a_performance_report_has_a_profile():
    workflow = Workflow(performance_report="report.html")
    assert dask_settings(workflow)["distributed"]["worker"]["profile"]["enabled"]
