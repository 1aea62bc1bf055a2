"""Slurm jobs as workers: submitting them, and the reasons why sbatch refuses one."""

import inspect
import shlex
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from wavefield.errors import ExperimentError
from wavefield.execution.cluster_settings import ClusterSettings
from wavefield.execution.dask_settings import dashboard_address
from wavefield.execution.worker_settings import THREAD_VARIABLES


def import_jobqueue() -> None:
    """Import dask-jobqueue without giving it Ctrl-C, which it takes over when it is imported."""
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


def slurm_cluster(workflow: ClusterSettings, logs: Path, settings: dict[str, object]) -> Any:
    """A `dask_jobqueue.SLURMCluster` without jobs so far; ``job_script()`` shows what it will submit."""
    import_jobqueue()
    from dask_jobqueue import SLURMCluster
    from dask_jobqueue.core import Job, JobQueueCluster
    from dask_jobqueue.slurm import SLURMJob
    from distributed.deploy.spec import ProcessInterface

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
            f"dask_jobqueue.SLURMCluster; it accepts {', '.join(sorted(known))}"
        )

    class ReportingJob(SLURMJob):
        """Keeps the reason why sbatch refuses a job; Dask would not report it."""

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
        job_cls = ReportingJob

    keywords = _keywords(workflow, logs, settings)
    try:
        Path(keywords["log_directory"]).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExperimentError(
            f"the jobs' logs cannot be written to {keywords['log_directory']} ({error.strerror}); make room, "
            "or name another place as `log_directory` in the workflow's `slurm` block"
        ) from None
    return Cluster(**keywords)


def _keywords(workflow: ClusterSettings, logs: Path, settings: dict[str, object]) -> dict[str, Any]:
    """Keywords of SLURMCluster: ours, then the workflow's."""
    given = workflow.slurm
    keywords: dict[str, Any] = {
        "cores": 1,
        "processes": given.get("cores", 1),
        # Slurm supervises the only worker of a job; a nanny would import everything once more
        "nanny": int(given.get("processes", given.get("cores", 1))) > 1,
        "job_name": "wavefield",
        "memory": workflow.memory or "2 GB",
        "log_directory": str(logs),
        "local_directory": "/tmp",
        "death_timeout": 120,
    }
    if "cores" in given and workflow.memory_bytes:
        keywords["memory"] = f"{workflow.memory_bytes * int(given['cores']) // 1_000_000} MB"
    keywords |= given
    keywords["job_script_prologue"] = environment_lines(settings) + list(given.get("job_script_prologue", []))
    ours = ["--preload", "wavefield.pipeline.dask_preload", "--dashboard-address", "127.0.0.1:0"]
    keywords["worker_extra_args"] = ours + list(given.get("worker_extra_args", []))
    options = {"dashboard_address": dashboard_address(workflow), "dashboard": bool(workflow.dashboard)}
    keywords["scheduler_options"] = options | dict(given.get("scheduler_options", {}))
    return keywords


def environment_lines(settings: dict[str, Any]) -> list[str]:
    """Lines of a job script that set what its workers need: one thread each, our configuration of Dask."""
    lines = [f"export {name}=1" for name in THREAD_VARIABLES]
    # compiled kernels: not on a home that may be full and is shared by nodes of several kinds
    lines.append('export NUMBA_CACHE_DIR="${NUMBA_CACHE_DIR:-${TMPDIR:-/tmp}/wavefield-$(id -u)}"')
    return lines + list(_exports(settings["distributed"], "DASK_DISTRIBUTED"))


def _exports(settings: dict[str, object], prefix: str) -> Iterator[str]:
    """Lines of a job script that give its workers a section of the configuration."""
    for name, value in settings.items():
        variable = f"{prefix}__{name.upper().replace('-', '_')}"
        if isinstance(value, dict):
            yield from _exports(value, variable)
        else:
            yield f"export {variable}={shlex.quote(str(value))}"


def count_jobs(workflow: ClusterSettings) -> tuple[int, int]:
    """Number of Slurm jobs that give the workers asked for."""
    processes = int(workflow.slurm.get("processes", workflow.slurm.get("cores", 1)))
    workers = workflow.workers
    if workers == "auto":
        return 1, 1
    fewest, most = (workers, workers) if isinstance(workers, int) else (workers.minimum, workers.maximum)
    return -(-fewest // processes), -(-most // processes)
