"""Run workers as Slurm jobs with dask-jobqueue, and report why jobs do not start."""

import getpass
import inspect
import logging
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wavefield.errors import ExperimentError
from wavefield.execution.process import PRELOAD, SETTINGS, WORKER_ENVIRONMENT
from wavefield.execution.workflow import Workflow

log = logging.getLogger("wavefield.run")

_POLL_SECONDS = 10.0  # between queries of Slurm
_CHECKS = 2  # checks without a job before a run ends: jobs may be listed late, workers connect late
_MAX_LINE = 300  # characters of a log line that are quoted in a message


def slurm_cluster(workflow: Workflow, logs: Path) -> Any:
    """Start and return a `dask_jobqueue.SLURMCluster`, whose jobs write their output to the folder `logs`."""
    _import_jobqueue()
    from dask_jobqueue import SLURMCluster
    from dask_jobqueue.core import Job as JobBase
    from dask_jobqueue.core import JobQueueCluster
    from dask_jobqueue.slurm import SLURMJob
    from distributed.deploy.spec import ProcessInterface

    class Job(SLURMJob):
        """A Slurm job that keeps the reason if sbatch refuses it; Dask alone would wait forever."""

        refused = ""

        async def start(self) -> None:
            try:
                await super().start()  # type: ignore[no-untyped-call]
            except (RuntimeError, OSError) as error:
                self.refused = str(error)
                await ProcessInterface.start(self)

        async def close(self) -> None:
            await super().close()  # type: ignore[no-untyped-call]
            await ProcessInterface.close(self)

    class Cluster(SLURMCluster):
        job_cls = Job

        def close(self, timeout: float | None = None) -> Any:
            out = super().close(timeout)
            # Dask would leave the credentials to the garbage collector
            for name in ("ca_file", "cert", "key"):
                if secret := getattr(self, f"_job_{name}", None):
                    secret.close()
            return out

    known = {
        name
        for kind in (SLURMJob, JobBase, JobQueueCluster)
        for name, parameter in inspect.signature(kind.__init__).parameters.items()
        if parameter.kind is not parameter.VAR_KEYWORD and name != "self"
    }
    unknown = [name for name in workflow.slurm if name not in known]
    if unknown:
        raise ExperimentError(
            f"the `slurm` block of the workflow: {unknown[0]!r} is not a keyword of "
            f"dask_jobqueue.SLURMCluster; it accepts {', '.join(sorted(known))}"
        )
    try:
        logs.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExperimentError(
            f"the jobs' logs cannot be written to {logs} ({error.strerror}); make room, or name another store"
        ) from None
    cluster = Cluster(**_keywords(workflow, logs))
    fewest, most = count_jobs(workflow)
    cluster.adapt(minimum_jobs=fewest, maximum_jobs=most)  # jobs that end or die are asked for again
    log.info("asked Slurm for %d jobs; the run begins when the first starts", fewest)
    return cluster


def _import_jobqueue() -> None:
    """Import dask-jobqueue, and then restore the handler of Ctrl-C that the import replaces."""
    try:
        interrupt = signal.getsignal(signal.SIGINT)
        import dask_jobqueue  # noqa: F401

        if signal.getsignal(signal.SIGINT) is not interrupt:
            signal.signal(signal.SIGINT, interrupt)
    except ValueError:  # signal handlers can only be set in the main thread
        raise ExperimentError("cluster: slurm is started from the main thread; call `run` there") from None


def _keywords(workflow: Workflow, logs: Path) -> dict[str, Any]:
    """Return keywords for `SLURMCluster`: defaults, replaced or extended by those in `workflow.slurm`."""
    given = dict(workflow.slurm)
    cores = int(given.get("cores", 1))
    environment = WORKER_ENVIRONMENT | {
        f"DASK_{name.upper().replace('.', '__').replace('-', '_')}": value
        for name, value in SETTINGS.items()
        if not isinstance(value, dict)
    }
    lines = [f"export {name}={str(value)!r}" for name, value in environment.items()]
    # cache of compiled kernels: not in the home folder, which different processors may share
    lines.append('export NUMBA_CACHE_DIR="${NUMBA_CACHE_DIR:-${TMPDIR:-/tmp}/wavefield-$(id -u)}"')
    return {
        "cores": cores,
        "processes": cores,
        # Slurm supervises a job with one worker; Dask's nanny process would import everything again
        "nanny": _processes(workflow) > 1,
        "job_name": "wavefield",
        "memory": f"{(workflow.memory_bytes or 2_000_000_000) * cores // 1_000_000} MB",
        "log_directory": str(logs),
        "local_directory": "/tmp",
        "shared_temp_directory": str(logs),  # for the TLS credentials
        "security": True,
        "death_timeout": 120,
        "silence_logs": "critical",
        "scheduler_options": {"dashboard": False, "dashboard_address": "127.0.0.1:0"},
        **given,
        "job_script_prologue": lines + list(given.pop("job_script_prologue", [])),
        "worker_extra_args": ["--preload", PRELOAD, "--no-dashboard", *given.pop("worker_extra_args", [])],
    }


def _processes(workflow: Workflow) -> int:
    """Return the number of workers (processes) in each Slurm job."""
    return int(workflow.slurm.get("processes", workflow.slurm.get("cores", 1)))


def count_jobs(workflow: Workflow) -> tuple[int, int]:
    """Return the least and the greatest number of Slurm jobs of a workflow; 1 and 1 for ``auto`` workers."""
    workers, processes = workflow.workers, _processes(workflow)
    if workers == "auto":
        return 1, 1
    fewest, most = (workers, workers) if isinstance(workers, int) else (workers.minimum, workers.maximum)
    return -(-fewest // processes), -(-most // processes)


class QueueWatch:
    """A check, called during a run, that warns why jobs wait in Slurm's queue.
    It raises ExperimentError if no job can start; Dask would wait for ever."""

    def __init__(self, cluster: Any) -> None:
        self._cluster = cluster
        self._checked_at = time.monotonic()
        self._reported = ""
        self._gone = 0  # number of successive checks without a queued or running job

    def __call__(self, client: Any) -> None:
        """Check the jobs if Dask's `client` has no workers; do nothing within 10 s of the previous check."""
        now = time.monotonic()
        if now - self._checked_at < _POLL_SECONDS:
            return
        self._checked_at = now
        if client.nthreads():
            self._gone = 0
            return
        jobs = list(self._cluster.workers.values())
        for job in jobs:
            if job.refused:
                raise ExperimentError(f"{_refusal(job.refused)}; correct the `slurm` block of the workflow")
        numbers = [str(job.job_id) for job in jobs if job.job_id]
        listed = queue_of(getpass.getuser())
        if listed is None or not numbers:
            return
        queued = {number: listed[number] for number in numbers if number in listed}
        self._gone = 0 if queued else self._gone + 1
        if self._gone > _CHECKS:
            raise ExperimentError(why_ended(numbers, Path(jobs[-1].log_directory)))
        reasons = sorted({reason for state, reason in queued.values() if state == "PENDING"})
        if reasons and str(reasons) != self._reported:
            self._reported = str(reasons)
            log.warning(
                "%d jobs wait in Slurm's queue (%s); the run begins when the first starts (`squeue --start` "
                "estimates when, `scontrol show partition` lists the limits)",
                len(queued),
                ", ".join(reasons),
            )


def _refusal(text: str) -> str:
    """Return a sentence on why sbatch rejects a job; `text` is the message of dask-jobqueue's error."""
    found = re.findall(r"sbatch: error: (.*)", text)
    if found:
        reason = "; ".join(dict.fromkeys(line.strip() for line in found))
    elif "No such file" in text:
        reason = "there is no sbatch here: start the run where jobs can be submitted"
    else:
        reason = text.strip().splitlines()[-1]
    return f"Slurm refuses the jobs of this run: {reason}"


def queue_of(user: str) -> dict[str, tuple[str, str]] | None:
    """Return (state, reason) of each of a user's Slurm jobs by job number (text); None if squeue fails."""
    command = ["squeue", "--noheader", f"--user={user}", "--format=%A|%T|%r"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    rows = (line.split("|", 2) for line in done.stdout.splitlines() if line.count("|") >= 2)
    return {number: (state, reason) for number, state, reason in rows if state != "COMPLETING"}


def why_ended(numbers: Sequence[str], logs: Path) -> str:
    """Return a message on jobs that ended before their workers started, with the last line of a log."""
    head = f"Slurm job {numbers[-1]} ended before its worker started; "
    for number in numbers:
        for path in sorted(logs.glob(f"*-{number}*")):
            lines = [line.strip() for line in path.read_text(errors="replace").splitlines() if line.strip()]
            if lines:
                return f"{head}{path} ends with: {lines[-1][:_MAX_LINE]}"
    return (
        f"{head}it left no log in {logs}: check that all nodes share this folder, that its disk has space, "
        f"and that the nodes have {sys.executable} (`python` in the `slurm` block names another)"
    )
