"""Slurm jobs as workers: asking for them, and saying why they do not come."""

import getpass
import inspect
import logging
import re
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

from wavefield.cubes.dask_settings import dashboard_address
from wavefield.cubes.worker_settings import THREAD_VARIABLES
from wavefield.cubes.workflow import Workflow
from wavefield.errors import ExperimentError

log = logging.getLogger("wavefield.run")

_MOST_FAILURES = 3  # jobs that end before their workers have started
_SAY_AFTER = 10.0  # seconds in the queue after which the reason is worth a line
_NEVER = (  # reasons for which Slurm keeps a job waiting until somebody changes it
    "BadConstraints",
    "InvalidAccount",
    "InvalidQOS",
    "PartitionConfig",
    "PartitionNodeLimit",
    "PartitionTimeLimit",
    "MaxCpuPerAccount",
    "MaxMemPerLimit",
    "WallDurationPerJobLimit",
    "CpuPerJobLimit",
    "MemoryPerJob",
    "AccountNotAllowed",
    "QOSNotAllowed",
)
_TELLING = re.compile(
    r"error|cannot|no such|not found|no module|no space|quota|denied|killed|cancelled|exceeded|refused", re.I
)


def import_jobqueue() -> None:
    """Import dask-jobqueue without giving it Ctrl-C, which it takes over when it is imported.

    Raises
    ------
    ExperimentError
        If it is not installed, or is first needed in another than the main thread, which has no Ctrl-C.
    """
    if "dask_jobqueue" in sys.modules:
        return
    if threading.current_thread() is not threading.main_thread():
        raise ExperimentError("cluster: slurm is started from the main thread; call `run` there")
    interrupt = signal.getsignal(signal.SIGINT)
    try:
        import dask_jobqueue  # noqa: F401
    except ImportError:
        raise ExperimentError("cluster: slurm needs dask-jobqueue; `pip install wavefield[slurm]`") from None
    finally:
        signal.signal(signal.SIGINT, interrupt)


def slurm_cluster(workflow: Workflow, logs: Path, settings: dict[str, Any]) -> Any:
    """A `dask_jobqueue.SLURMCluster` that has not asked for jobs yet; its ``job_script()`` can be looked at.

    Parameters
    ----------
    workflow : Workflow
        With ``cluster: slurm``.
    logs : path
        Folder for what the jobs say.
    settings : dict
        Dask's configuration, for the workers as well.

    Returns
    -------
    dask_jobqueue.SLURMCluster
        Its attribute ``refusals`` lists what sbatch said of jobs that it did not take.

    Raises
    ------
    ExperimentError
        If dask-jobqueue is not installed, or a keyword is unknown to it.
    """
    import_jobqueue()
    from dask_jobqueue import SLURMCluster
    from dask_jobqueue.core import Job, JobQueueCluster
    from dask_jobqueue.slurm import SLURMJob

    known = {
        name
        for kind in (SLURMJob, Job, JobQueueCluster)
        for name, parameter in inspect.signature(kind.__init__).parameters.items()
        if parameter.kind is not parameter.VAR_KEYWORD and name != "self"
    }
    unknown = [name for name in workflow.slurm if name not in known]
    if unknown:
        raise ExperimentError(
            f"the `slurm` block of the workflow: {unknown[0]!r} is not a keyword of "
            f"dask_jobqueue.SLURMCluster; it knows {', '.join(sorted(known))}"
        )

    class Asked(SLURMJob):
        """Remembers why sbatch refuses a job, which Dask only logs."""

        async def start(self) -> None:
            try:
                await super().start()  # type: ignore[no-untyped-call]
            except (RuntimeError, OSError) as error:
                Cluster.refusals.append(str(error))
                raise

    class Cluster(SLURMCluster):
        job_cls = Asked
        refusals: ClassVar[list[str]] = []

    keywords = _keywords(workflow, logs, settings)
    try:
        Path(keywords["log_directory"]).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExperimentError(
            f"the jobs' logs cannot be written to {keywords['log_directory']} ({error.strerror}); make room, "
            "or name another place as `log_directory` in the workflow's `slurm` block"
        ) from None
    return Cluster(**keywords)


def _keywords(workflow: Workflow, logs: Path, settings: dict[str, Any]) -> dict[str, Any]:
    """Keywords of SLURMCluster: ours, then the workflow's."""
    given = workflow.slurm
    keywords: dict[str, Any] = {
        "cores": 1,
        "processes": given.get("cores", 1),
        "job_name": "wavefield",
        "memory": workflow.memory or "2 GB",
        "log_directory": str(logs),
        "local_directory": "/tmp",
        "death_timeout": 120,
    }
    if "cores" in given and workflow.memory_bytes:
        keywords["memory"] = f"{workflow.memory_bytes * int(given['cores']) // 1_000_000} MB"
    keywords |= given
    prologue = [f"export {name}=1" for name in THREAD_VARIABLES]
    # compiled kernels: not on a home that may be full and is shared by nodes of several kinds
    prologue.append('export NUMBA_CACHE_DIR="${NUMBA_CACHE_DIR:-${TMPDIR:-/tmp}/wavefield-$(id -u)}"')
    prologue += _exports(settings["distributed"], "DASK_DISTRIBUTED")
    keywords["job_script_prologue"] = prologue + list(given.get("job_script_prologue", []))
    ours = ["--preload", "wavefield.cubes.dask_preload", "--dashboard-address", "127.0.0.1:0"]
    keywords["worker_extra_args"] = ours + list(given.get("worker_extra_args", []))
    options = {"dashboard_address": dashboard_address(workflow), "dashboard": bool(workflow.dashboard)}
    keywords["scheduler_options"] = options | dict(given.get("scheduler_options", {}))
    return keywords


def _exports(settings: dict[str, Any], prefix: str) -> Iterator[str]:
    """Lines of a job script that give its workers a section of the configuration."""
    for name, value in settings.items():
        variable = f"{prefix}__{name.upper().replace('-', '_')}"
        if isinstance(value, dict):
            yield from _exports(value, variable)
        else:
            yield f"export {variable}={shlex.quote(str(value))}"


def count_jobs(workflow: Workflow) -> tuple[int, int]:
    """Number of Slurm jobs that give the workers asked for.

    Parameters
    ----------
    workflow : Workflow
        With ``cluster: slurm``.

    Returns
    -------
    fewest, most : int
        Jobs; the same unless the workflow says from how many to how many workers.
    """
    processes = int(workflow.slurm.get("processes", workflow.slurm.get("cores", 1)))
    workers = workflow.workers
    if workers == "auto":
        return 1, 1
    fewest, most = (workers, workers) if isinstance(workers, int) else (workers.minimum, workers.maximum)
    return -(-fewest // processes), -(-most // processes)


class Watch:
    """Looks after jobs while no work comes back: says why they wait, and ends a run whose jobs never work.

    Parameters
    ----------
    cluster : dask_jobqueue.SLURMCluster
        As from `slurm_cluster`.
    logs : path
        Folder of the jobs' logs.
    """

    def __init__(self, cluster: Any, logs: Path) -> None:
        self._cluster = cluster
        self._logs = logs
        self._since = time.monotonic()
        self._said = ""
        self._gone: dict[str, float] = {}
        self._failed: list[str] = []

    def __call__(self) -> None:
        """Look once.

        Raises
        ------
        ExperimentError
            If Slurm refuses the jobs, will never start them, or they end before their workers start.
        """
        if self._cluster.refusals:
            raise ExperimentError(_refusal(self._cluster.refusals[0]))
        connected = {str(info["id"]) for info in self._cluster.scheduler_info["workers"].values()}
        jobs = {
            str(job.job_id): str(name)
            for name, job in list(self._cluster.workers.items())
            if getattr(job, "job_id", None)
        }
        silent = {
            number: name
            for number, name in jobs.items()
            if not any(one == name or one.startswith(f"{name}-") for one in connected)
        }
        if not silent:
            return
        states = _states()
        if states is None:  # Slurm does not answer just now
            return
        self._look_for_failures(silent, states)
        if not connected:
            self._look_at_queue({number: states[number] for number in silent if number in states})

    def _look_for_failures(self, silent: dict[str, str], states: dict[str, tuple[str, str]]) -> None:
        now = time.monotonic()
        for number, name in silent.items():
            if number in states:
                self._gone.pop(number, None)
            elif now - self._gone.setdefault(number, now) > 1.0:  # two looks: Slurm may be late to list it
                self._failed.append(number)
                self._cluster.sync(self._cluster.scale_down, [name])  # so that it is asked for again
        if len(self._failed) >= min(_MOST_FAILURES, max(1, len(silent))):
            raise ExperimentError(f"{why_ended(self._failed[0], self._logs)}")

    def _look_at_queue(self, waiting: dict[str, tuple[str, str]]) -> None:
        reasons = sorted({reason for state, reason in waiting.values() if state == "PENDING"})
        for reason in reasons:
            if any(never in reason for never in _NEVER):
                raise ExperimentError(
                    f"Slurm will never start the jobs of this run: {reason}; correct `queue`, `walltime`, "
                    "`cores` or `memory` in the workflow (`scontrol show partition` says what there is)"
                )
        sentence = ", ".join(reasons)
        if sentence and sentence != self._said and time.monotonic() - self._since > _SAY_AFTER:
            self._said = sentence
            log.warning(
                "%d jobs wait in Slurm's queue (%s); the run begins when the first starts (`squeue --start` "
                "estimates when)",
                len(waiting),
                sentence,
            )


def _refusal(text: str) -> str:
    said = re.findall(r"sbatch: error: (.*)", text)
    if said:
        reason = "; ".join(dict.fromkeys(line.strip() for line in said))
    elif "No such file" in text:
        reason = "there is no sbatch here: start the run where jobs can be submitted"
    else:
        reason = text.strip().splitlines()[-1]
    return f"Slurm refuses the jobs of this run: {reason}; correct the `slurm` block of the workflow"


def _states() -> dict[str, tuple[str, str]] | None:
    """State and reason of all our jobs that Slurm still lists, by number."""
    command = ["squeue", "--noheader", f"--user={getpass.getuser()}", "--format=%A|%T|%r"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    rows = (line.split("|", 2) for line in done.stdout.splitlines() if line.count("|") >= 2)
    return {number: (state, reason) for number, state, reason in rows if state not in ("COMPLETING",)}


def why_ended(number: str, logs: Path) -> str:
    """A sentence that says why a job ended before its workers started, as far as Slurm and its log tell.

    Parameters
    ----------
    number : str
        Of the job.
    logs : path
        Folder of the jobs' logs.

    Returns
    -------
    str
    """
    state = ""
    try:
        shown = subprocess.run(
            ["scontrol", "show", "job", number], capture_output=True, text=True, timeout=30
        ).stdout
        found = dict(re.findall(r"(JobState|Reason|ExitCode)=(\S+)", shown))
        state = ", ".join(found[name] for name in ("JobState", "Reason") if found.get(name, "None") != "None")
    except (OSError, subprocess.SubprocessError):
        pass
    head = f"Slurm job {number} ended before its workers started{f' ({state})' if state else ''}; "
    files = [*sorted(logs.glob(f"*-{number}*.err")), *sorted(logs.glob(f"*-{number}*.out"))]
    for path in files:
        lines = [line.strip() for line in path.read_text(errors="replace").splitlines() if line.strip()]
        if lines:
            telling = [line for line in lines if _TELLING.search(line)] or lines
            return f"{head}{path} says: {telling[-1][:300]}"
    return (
        f"{head}it left no log in {logs}: is that a folder on a disk that all nodes share, with room, and is "
        "`python` of the workflow's `slurm` block there on the nodes?"
    )
