"""Where blocks are measured: in this process, in others of this machine, in Slurm jobs, on any scheduler."""

import ctypes
import functools
import inspect
import logging
import multiprocessing
import os
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

import dask

from wavefield.cubes.workflow import Workflow
from wavefield.errors import ExperimentError, StoreError

log = logging.getLogger("wavefield.run")
T = TypeVar("T")
R = TypeVar("R")
Work = Callable[[T], R]

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)

# Blocks are independent and a worker may die for reasons of its own, so be patient with both. Tasks take
# minutes, so look after them less often than every few ms: for two workers that takes 15 % of a core.
_DASK: dict[str, Any] = {
    "array": {"query-planning": False},
    "distributed": {
        "scheduler": {
            "allowed-failures": 10,
            "worker-ttl": "300s",
            "active-memory-manager": {"start": False},
        },
        "worker": {
            "memory": {
                "target": False,
                "spill": False,
                "pause": 0.9,
                "terminate": 0.95,
                "monitor-interval": "500ms",
            },
            "profile": {"enabled": False},
        },
        "comm": {"timeouts": {"connect": "60s", "tcp": "60s"}},
        "admin": {
            "tick": {"interval": "1s", "cycle": "5s", "limit": "60s"},
            "system-monitor": {"interval": "2s", "disk": False, "gil": {"enabled": False}},
        },
    },
}
_PROFILE = {"distributed": {"worker": {"profile": {"enabled": True}}}}  # a report is made from it
_FORKED = {"distributed": {"worker": {"multiprocessing-method": "forkserver"}}}
_NEEDED = ["wavefield.cubes.work", "wavefield.measurement.measure"]  # by every worker

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # of malloc.h
_LARGEST_KEPT = 64_000_000  # bytes of an array; an image of 4 Mpx in floats has 16 MB
_MOST_KEPT = 256_000_000  # bytes at the end of the heap

_SCHEDULER_TIMEOUT = "20s"  # for a scheduler that should be running already


def one_thread() -> None:
    """Keep OpenCV and BLAS of this process to one thread: the workers are the parallelism.

    No kernel of ours asks numba for threads, and numba refuses a change of its number of threads at run time.
    """
    import cv2

    cv2.setNumThreads(1)
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"


def keep_memory(one_arena: bool = False) -> None:
    """Let the C library keep freed arrays for the next ones, within bounds, where it is glibc.

    A step makes and drops hundreds of arrays of a few MB. Handed back each time, every page of theirs is
    mapped and cleared again, and that takes longer than measuring. Dask's nannies ask for just that
    (``MALLOC_TRIM_THRESHOLD_``).

    Parameters
    ----------
    one_arena : bool
        Let new threads share the memory of the main thread: those of their own are handed back earlier.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library, another system
        return
    mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT)
    mallopt(_M_TRIM_THRESHOLD, _MOST_KEPT)
    if one_arena:
        mallopt(_M_ARENA_MAX, 1)


def count_workers(workflow: Workflow) -> int:
    """Number of workers that a workflow asks for.

    Parameters
    ----------
    workflow : Workflow
        The workflow.

    Returns
    -------
    int
    """
    if workflow.cluster == "none":
        return 1
    if workflow.workers == "auto":
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return workflow.workers


@contextmanager
def open_cluster(
    workflow: Workflow, ahead: bool = False
) -> Iterator[Callable[[Work, Sequence[Any]], Generator[Any]]]:
    """Give a function that maps work over items, once, on workers that come and go with it.

    Parameters
    ----------
    workflow : Workflow
        Where to work.
    ahead : bool
        Start processes of this machine at once, while the caller prepares their work.

    Yields
    ------
    map_unordered : callable
        ``map_unordered(work, items)`` iterates over (item, result or exception) as they are done. It raises
        ExperimentError if the cluster cannot be started or the scheduler not be reached.
    """
    if workflow.cluster == "none" or (workflow.cluster == "local" and count_workers(workflow) == 1):
        yield _map_here
        return
    ahead = ahead and workflow.cluster == "local"
    settings = dask_settings(workflow)
    if workflow.cluster == "slurm":
        import_jobqueue()  # here, because another thread cannot
    if ahead:
        _start_fork_server(settings)
    # the thread goes first, so that no cluster comes up after all has been closed
    with ExitStack() as stack, _configured(settings), ThreadPoolExecutor(1) as thread:
        start = functools.cache(lambda: thread.submit(_connect, workflow, stack))
        if ahead:
            start()

        def map_unordered(work: Work, items: Sequence[Any]) -> Generator[Any]:
            with stack:  # the workers end with their work, while the caller still guards the store
                with undisturbed():  # what is closed while it starts prints tracebacks from other threads
                    client = start().result()
                if client.dashboard_link and workflow.dashboard:
                    log.info("dashboard: %s", client.dashboard_link)
                if workflow.performance_report:
                    from distributed import performance_report

                    stack.enter_context(client.as_current())
                    stack.enter_context(performance_report(filename=workflow.performance_report))
                yield from _map_on(client, work, items)

        yield map_unordered


def dask_settings(workflow: Workflow) -> dict[str, Any]:
    """Dask's configuration for a run.

    Parameters
    ----------
    workflow : Workflow
        What it says of ``dask`` goes first.

    Returns
    -------
    dict
        Sections of Dask's configuration, as far as they differ from Dask's own.
    """
    profile = _PROFILE if workflow.performance_report else {}
    forked = _FORKED if workflow.cluster == "local" and sys.platform == "linux" else {}
    return dask.config.merge(_DASK, profile, forked, workflow.dask)


def _start_fork_server(settings: dict[str, Any]) -> None:
    """Start the process that workers are forked from, if they are: it imports what they need once for all.

    It forks from one thread, so that no lock is ever copied while it is held, and ends with this process.
    Neither it nor its workers hear Ctrl-C and Slurm's warning, which are for the run itself.
    """
    if settings["distributed"]["worker"].get("multiprocessing-method") != "forkserver":
        return
    from multiprocessing import forkserver, resource_tracker

    resource_tracker.ensure_running()  # would let the signals through again
    multiprocessing.set_forkserver_preload(["distributed", "distributed.nanny", *_NEEDED])
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))  # BLAS reads them when it is imported
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGUSR1))
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _exports(settings: dict[str, Any], prefix: str) -> Iterator[str]:
    """Lines of a job script that give its workers a section of the configuration."""
    for name, value in settings.items():
        variable = f"{prefix}__{name.upper().replace('-', '_')}"
        if isinstance(value, dict):
            yield from _exports(value, variable)
        else:
            yield f"export {variable}={shlex.quote(str(value))}"


@contextmanager
def _configured(configuration: dict[str, Any]) -> Iterator[None]:
    import distributed  # noqa: F401  its defaults join the configuration on import: before that is put aside

    # dask.config.set would replace whole sections
    before = dask.config.config.copy()
    merged = dask.config.merge(dask.config.config, configuration)
    with dask.config.config_lock:
        dask.config.config.clear()
        dask.config.config.update(merged)
    try:
        yield
    finally:
        with dask.config.config_lock:
            dask.config.config.clear()
            dask.config.config.update(before)


def _connect(workflow: Workflow, stack: ExitStack) -> Any:
    from distributed import Client, LocalCluster, utils

    utils._forkserver_preload_set = True  # by us: its own list would import pandas here and there

    if workflow.cluster == "address":
        try:
            client = Client(workflow.address, timeout=_SCHEDULER_TIMEOUT, set_as_default=False)
            return _settled(client, stack)
        except OSError as error:
            raise ExperimentError(
                f"no scheduler answers at {workflow.address} ({error}); start one with "
                "`dask scheduler`, or correct `address` in the workflow"
            ) from None
    if workflow.cluster == "slurm":
        cluster = stack.enter_context(slurm_cluster(workflow))
        jobs = count_jobs(workflow)
        cluster.adapt(minimum_jobs=jobs, maximum_jobs=jobs)  # jobs that end or die are asked for again
        log.info("asked Slurm for %d jobs; the run begins when the first starts", jobs)
    else:
        _start_fork_server(dask_settings(workflow))
        cluster = stack.enter_context(
            LocalCluster(
                n_workers=count_workers(workflow),
                threads_per_worker=1,
                processes=True,
                memory_limit=workflow.memory_bytes or "auto",
                dashboard_address=workflow.dashboard,
                preload=_NEEDED,
                silence_logs=logging.ERROR,
            )
        )
    return _settled(Client(cluster, timeout="60s", set_as_default=False), stack)


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


def slurm_cluster(workflow: Workflow) -> Any:
    """A `dask_jobqueue.SLURMCluster` that has not asked for jobs yet; its ``job_script()`` can be looked at.

    Parameters
    ----------
    workflow : Workflow
        With ``cluster: slurm``.

    Returns
    -------
    dask_jobqueue.SLURMCluster

    Raises
    ------
    ExperimentError
        If dask-jobqueue is not installed, or a keyword is unknown to it.
    """
    import_jobqueue()
    from dask_jobqueue import SLURMCluster
    from dask_jobqueue.core import Job, JobQueueCluster
    from dask_jobqueue.slurm import SLURMJob

    keywords: dict[str, Any] = {
        "cores": 1,
        "processes": workflow.slurm.get("cores", 1),
        "job_name": "wavefield",
    }
    keywords["memory"] = workflow.memory or "2 GB"
    if "cores" in workflow.slurm and workflow.memory_bytes:
        keywords["memory"] = f"{workflow.memory_bytes * int(workflow.slurm['cores']) // 1_000_000} MB"
    keywords |= workflow.slurm
    prologue = [f"export {name}=1" for name in THREAD_VARIABLES]
    prologue += _exports(dask_settings(workflow)["distributed"], "DASK_DISTRIBUTED")
    keywords["job_script_prologue"] = prologue + list(workflow.slurm.get("job_script_prologue", []))
    dashboard = {"dashboard_address": workflow.dashboard} if workflow.dashboard else {"dashboard": False}
    keywords.setdefault("scheduler_options", dashboard)
    known = {
        name
        for kind in (SLURMJob, Job, JobQueueCluster)
        for name, parameter in inspect.signature(kind.__init__).parameters.items()
        if parameter.kind is not parameter.VAR_KEYWORD and name != "self"
    }
    unknown = [name for name in keywords if name not in known]
    if unknown:
        raise ExperimentError(
            f"the `slurm` block of the workflow: {unknown[0]!r} is not a keyword of "
            f"dask_jobqueue.SLURMCluster; it knows {', '.join(sorted(known))}"
        )
    return SLURMCluster(**keywords)


def count_jobs(workflow: Workflow) -> int:
    """Number of Slurm jobs that give the workers asked for.

    Parameters
    ----------
    workflow : Workflow
        With ``cluster: slurm``.

    Returns
    -------
    int
    """
    processes = int(workflow.slurm.get("processes", workflow.slurm.get("cores", 1)))
    return 1 if workflow.workers == "auto" else -(-workflow.workers // processes)


def _settled(client: Any, stack: ExitStack) -> Any:
    stack.enter_context(client)
    client.register_plugin(_make_plugin())
    return client


def _make_plugin() -> Any:
    from distributed import WorkerPlugin

    class Settle(WorkerPlugin):
        """Sets threads and memory, and leaves Ctrl-C and Slurm's warning to the run itself."""

        name = "wavefield-settle"

        def setup(self, worker: Any) -> None:
            one_thread()
            keep_memory(one_arena=True)
            if threading.current_thread() is threading.main_thread():
                for name in ("SIGINT", "SIGUSR1"):
                    if hasattr(signal, name):
                        signal.signal(getattr(signal, name), signal.SIG_IGN)

    return Settle()


def _map_here(work: Work, items: Sequence[Any]) -> Generator[Any]:
    one_thread()
    keep_memory()
    for item in items:
        try:
            result: Any = work(item)
        except Exception as error:
            result = error
        yield item, result


@contextmanager
def undisturbed() -> Iterator[None]:
    """Put off the signals that stop a run until a call is over; a second one is heard at once.

    A call of distributed that is interrupted before it began prints a traceback from another thread.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    names = [name for name in ("SIGINT", "SIGTERM", "SIGUSR1", "SIGALRM") if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in (getattr(signal, name) for name in names)}
    heard: list[int] = []

    def later(number: int, frame: Any) -> None:
        heard.append(number)
        if len(heard) > 1:
            tell(number, frame)

    def tell(number: int, frame: Any) -> None:
        handler = before[signal.Signals(number)]
        if callable(handler):
            handler(number, frame)

    ours = [number for number, handler in before.items() if callable(handler)]
    for number in ours:
        signal.signal(number, later)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, before[number])
    if heard:
        tell(heard[0], None)


def _map_on(client: Any, work: Work, items: Sequence[Any]) -> Generator[Any]:
    from distributed import CancelledError, as_completed

    futures = {
        client.submit(work, item, pure=False, key=f"block-{k}-{id(items)}"): item
        for k, item in enumerate(items)
    }
    lost = StoreError("the scheduler was lost; what is done is kept: run the same command again to go on")
    try:
        for future in as_completed(futures, loop=client.loop):
            if future.status not in ("finished", "error"):  # cancelled or lost with its scheduler
                raise lost
            with undisturbed():
                result: Any = future.result() if future.status == "finished" else future.exception()
            yield futures.pop(future), result
    except (OSError, CancelledError) as error:  # the connection broke while a report was fetched
        raise lost from error
    finally:
        if futures and client.status == "running":
            client.cancel(list(futures), force=True)
