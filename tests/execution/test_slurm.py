"""What Slurm is asked for, and what is reported of jobs that do not start; a real Slurm: tests/workflows."""

import signal
import stat
from types import SimpleNamespace

import pytest

from wavefield.errors import ExperimentError
from wavefield.execution import slurm
from wavefield.execution.slurm import QueueWatch, count_jobs, slurm_cluster
from wavefield.pipeline import Workflow


@pytest.fixture(autouse=True)
def no_sbatch(monkeypatch):
    """No test here submits a job."""
    monkeypatch.setenv("PATH", "/nowhere")


def script_of(workflow, logs):
    before = signal.getsignal(signal.SIGINT)
    with slurm_cluster(workflow, logs) as jobs:
        assert signal.getsignal(signal.SIGINT) is before, "dask-jobqueue takes over Ctrl-C"
        secrets = [*logs.glob(".dask*")]
        assert {stat.S_IMODE(one.stat().st_mode) for one in secrets} == {0o600}
        script = jobs.job_script()
    assert not any(one.exists() for one in secrets), "credentials go with their run"
    return script


def test_the_job_that_slurm_is_asked_for(tmp_path):
    block = {
        "queue": "cpu",
        "cores": 8,
        "walltime": "04:00:00",
        "job_script_prologue": ["module load python"],
    }
    workflow = Workflow(cluster="slurm", workers=32, memory="2 GB", slurm=block)
    assert count_jobs(workflow) == (4, 4)
    script = script_of(workflow, tmp_path)
    for line in (
        "#SBATCH -J wavefield",
        "#SBATCH -p cpu",
        "#SBATCH --cpus-per-task=8",
        "#SBATCH --mem=15G",
        "#SBATCH -t 04:00:00",
        "export OMP_NUM_THREADS='1'",
        "export DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED='False'",
        'export NUMBA_CACHE_DIR="${NUMBA_CACHE_DIR:-${TMPDIR:-/tmp}/wavefield-$(id -u)}"',
        "module load python",
    ):
        assert line in script
    for option in ("tls://", "--tls-cert", "--nworkers 8", "--nanny", "--nthreads 1", "--no-dashboard"):
        assert option in script


def test_the_only_worker_of_a_job_has_no_nanny_and_unknown_keywords_are_named(tmp_path):
    assert "--no-nanny" in script_of(Workflow(cluster="slurm", slurm={"cores": 1}), tmp_path)
    with pytest.raises(ExperimentError, match=r"the `slurm` block of the workflow: .*colour"):
        slurm_cluster(Workflow(cluster="slurm", slurm={"colour": "blue"}), tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(ExperimentError, match="the jobs' logs cannot be written"):
        slurm_cluster(Workflow(cluster="slurm"), tmp_path / "file" / "logs")


@pytest.fixture
def checks(monkeypatch, tmp_path):
    """A watch over one job, and a check at which Slurm lists some jobs."""
    monkeypatch.setattr(slurm, "_POLL_SECONDS", -1.0)
    job = SimpleNamespace(refused="", job_id="17", log_directory=str(tmp_path))
    watch = QueueWatch(SimpleNamespace(workers={"0": job}))

    def check(listed, workers=None):
        monkeypatch.setattr(slurm, "queue_of", lambda user: listed)
        watch(SimpleNamespace(nthreads=lambda: workers or {}))

    return job, check


def test_the_reason_for_which_jobs_wait_is_logged_once(checks, caplog):
    for _ in range(3):
        checks[1]({"17": ("PENDING", "Priority")})
    assert caplog.text.count("1 jobs wait in Slurm's queue (Priority)") == 1


def test_jobs_that_sbatch_refuses_end_the_run(checks):
    checks[0].refused = "stderr:\nsbatch: error: invalid partition specified: nowhere\n"
    with pytest.raises(ExperimentError, match="refuses the jobs of this run: invalid partition"):
        checks[1]({})


def test_jobs_that_ended_without_a_worker_end_the_run_with_their_log(checks, tmp_path):
    (tmp_path / "wavefield-17.err").write_text("Loading\nNo module named 'wavefield'\n")
    checks[1]({"17": ("RUNNING", "None")})
    checks[1]({})
    checks[1]({})
    checks[1]({}, {"tls://worker": 1})  # one is there for a while: what ends later is counted anew
    checks[1]({})
    checks[1]({})
    with pytest.raises(
        ExperimentError, match=r"ended before .*17\.err ends with: No module named 'wavefield'"
    ):
        checks[1]({})
