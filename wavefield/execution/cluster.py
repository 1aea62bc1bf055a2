"""Apply a function to chunks of steps: in this process, or on Dask workers here, in Slurm jobs, or elsewhere.

The scheduler that a run starts accepts connections from that run only: it uses TLS with credentials made for
each run, and serves no dashboard.
"""

import functools
import logging
import os
import pickle
import signal
import sys
import time
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import wavefield
from wavefield.errors import ExperimentError, StoreError, WavefieldError
from wavefield.execution.process import (
    PRELOAD,
    SETTINGS,
    children_ignore_ctrl_c,
    deferred_signals,
    memory_error,
    one_opencv_thread,
    set_up_worker,
)
from wavefield.execution.workflow import Workflow

if TYPE_CHECKING:  # takes a second to import
    from distributed import Client

log = logging.getLogger("wavefield.run")

Work = Callable[[Any], Any]  # from an item, such as a chunk, to its result
Results = Generator[tuple[Any, Any], None, None]  # each item with its result, or with the error it raised
MapUnordered = Callable[[Work, Sequence[Any]], Results]
Watch = Callable[["Client"], None]  # looks at the workers now and then, and may raise an error

_MOST_THREADS = 4  # threads of the run's own process
_TASKS_PER_WORKER = 2  # tasks that the scheduler holds: one running, one ready
_POLL_SECONDS = 2.0  # between checks of the workers while no result arrives
_START_SECONDS = 300.0  # limit for the start of local workers, which takes 3 s on an idle machine
_SCHEDULER_TIMEOUT = "20s"  # to connect to a scheduler that is running already


def count_workers(workflow: Workflow) -> int:
    """Return the greatest number of workers of a workflow; one per core for ``auto``, 1 without a cluster."""
    if workflow.cluster == "none":
        return 1
    if workflow.workers == "auto":
        return _cores()
    return workflow.workers if isinstance(workflow.workers, int) else workflow.workers.maximum


def threads_here(workflow: Workflow) -> int:
    """Return how many threads the process that starts a run may use while no workers run; at most 4."""
    return min(count_workers(workflow), _cores(), _MOST_THREADS)


def _cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def open_cluster(
    workflow: Workflow, logs: Path | None = None, imports: Sequence[str] = ()
) -> Iterator[MapUnordered]:
    """Context manager: start the workers of a workflow and yield a map function; workers end with the block.
    `map(work, items)` yields each item with its result, or with the exception that it raised, in the order of
    completion. `logs` is the folder for output of Slurm jobs; local workers first import `imports`."""
    if workflow.cluster == "none" or (workflow.cluster == "local" and count_workers(workflow) == 1):
        yield _map_here
        return
    import dask
    import distributed  # before our configuration, which its defaults would otherwise replace

    environment = dict(os.environ)  # Dask changes it for its workers
    try:
        # our own messages report workers that end, so Dask's are silenced
        silent = distributed.utils.silence_logging_cmgr(logging.CRITICAL)
        with dask.config.set(SETTINGS), silent, ExitStack() as stack:
            with deferred_signals():
                client, watch = _connect(workflow, logs or Path("wavefield.jobs").absolute(), imports, stack)
            yield functools.partial(_map_on, client, watch, count_workers(workflow))
    finally:
        for name in os.environ.keys() - environment.keys():
            del os.environ[name]
        os.environ.update(environment)


def _connect(
    workflow: Workflow, logs: Path, imports: Sequence[str], stack: ExitStack
) -> tuple["Client", Watch]:
    """Return a Dask client of the workflow's scheduler, and a function that checks the workers during a run.
    Closing `stack` ends the client and the workers, except those of a scheduler given by its address."""
    from distributed import Client

    if workflow.cluster == "address":
        try:
            client = Client(workflow.address, timeout=_SCHEDULER_TIMEOUT, set_as_default=False)
        except OSError as error:
            raise ExperimentError(
                f"no scheduler answers at {workflow.address} ({error}); start one with "
                "`dask scheduler`, or correct `address` in the workflow"
            ) from None
        return stack.enter_context(client), _WithoutWorkers()
    if workflow.cluster == "slurm":
        from wavefield.execution.slurm import QueueWatch, slurm_cluster

        cluster = stack.enter_context(slurm_cluster(workflow, logs))
        return stack.enter_context(Client(cluster, timeout="60s", set_as_default=False)), QueueWatch(cluster)
    cluster = stack.enter_context(_local_cluster(workflow, imports))
    stack.callback(_end_workers, cluster)
    client = stack.enter_context(Client(cluster, timeout="60s", set_as_default=False))
    cluster.scale(count_workers(workflow))  # after the client, which would wait for the workers
    return client, _LocalWorkers()


def _local_cluster(workflow: Workflow, imports: Sequence[str]) -> Any:
    """Return a Dask cluster on this machine, still without workers; they will first import `imports`."""
    from distributed import LocalCluster
    from distributed.utils import get_mp_context

    context = get_mp_context()
    if context.get_start_method() == "forkserver":  # workers share the memory of imported modules
        context.set_forkserver_preload(["distributed", PRELOAD, *imports])
    with children_ignore_ctrl_c():  # a thread that starts here will start the workers
        return LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            host="127.0.0.1",
            security=True,
            memory_limit=workflow.memory_bytes or "auto",
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            worker_dashboard_address="127.0.0.1:0",
            preload=[PRELOAD, *imports],
            silence_logs=logging.CRITICAL,
        )


def _end_workers(cluster: Any) -> None:
    """End the workers of a local cluster at once; Dask would first wait for unfinished chunks."""
    for nanny in cluster.workers.values():
        nanny.auto_restart = False
        with suppress(OSError, TypeError):  # it has no process now
            os.kill(nanny.pid, signal.SIGTERM)


class _LocalWorkers:
    """A check, called during a run, that raises StoreError if this machine has had no worker for 300 s."""

    def __init__(self) -> None:
        self._seen = time.monotonic()

    def __call__(self, client: "Client") -> None:
        if client.nthreads():
            self._seen = time.monotonic()
        elif time.monotonic() - self._seen > _START_SECONDS:
            raise StoreError(
                "the workers of this machine do not start; run the same command again, or set "
                "`cluster: none` in the workflow to measure in the run's own process"
            )


class _WithoutWorkers:
    """A check, called during a run, that warns once if the scheduler has no workers yet."""

    reported = False

    def __call__(self, client: "Client") -> None:
        if not self.reported and not client.nthreads():
            self.reported = True
            address = client.scheduler_info()["address"]
            log.warning(
                "the scheduler at %s has no workers; the run begins when the first is started: "
                "`dask worker %s --nthreads 1`",
                address,
                address,
            )


def _map_here(work: Work, items: Sequence[Any]) -> Results:
    """Yield each item with the result of `work(item)`, or with the exception raised, in this process."""
    with one_opencv_thread():
        for item in items:
            try:
                result: Any = work(item)
            except Exception as error:
                result = memory_error(error) or error
            yield item, result


def _map_on(client: "Client", watch: Watch, workers: int, work: Work, items: Sequence[Any]) -> Results:
    """Yield each item with the result of `work(item)`, or with the exception raised, in order of completion.
    Up to `workers` Dask workers run; `watch(client)` checks them. StoreError if the scheduler is lost."""
    from distributed import CancelledError, wait

    packed, mark = pickle.dumps(work), uuid.uuid4().hex
    left = deque(range(len(items)))
    running: dict[Any, int] = {}
    try:
        while left or running:
            while left and len(running) < _TASKS_PER_WORKER * workers:
                k = left.popleft()
                task = client.submit(
                    _do, packed, own_versions(), items[k], key=f"chunk-{k}-{mark}", pure=False
                )
                running[task] = k
            watch(client)
            try:
                with client.as_current():
                    done = wait(list(running), timeout=_POLL_SECONDS, return_when="FIRST_COMPLETED").done
            except TimeoutError:
                continue
            for task in done:
                yield items[running.pop(task)], _result(task)
    except (OSError, CancelledError) as error:
        raise StoreError(
            "the scheduler was lost; what is done is kept: run the same command again to go on"
        ) from error
    finally:
        if running and client.status == "running":
            client.cancel(list(running), force=True)


def _result(task: Any) -> Any:
    """Return the result of a finished Dask task, or its exception, with a remedy if Dask raised it."""
    from distributed import CancelledError, KilledWorker

    try:
        return task.result()
    except CancelledError:
        raise
    except KilledWorker as error:
        return StoreError(
            f"{error.allowed_failures + 1} workers ended while they worked on it: if memory ran out, give "
            "more `memory`, fewer `workers` or a smaller `steps_per_block` in the workflow; `cluster: none` "
            "shows any other cause"
        )
    except Exception as error:
        missing = isinstance(error, ModuleNotFoundError) and (error.name or "").startswith("wavefield")
        if isinstance(error, WavefieldError) or not (missing or "deserialization" in str(error)):
            return error
        return ExperimentError(
            f"scheduler or workers cannot load wavefield {wavefield.__version__} ({error}); start them from "
            "an environment in which it is installed"
        )


def _do(packed: bytes, versions: str, item: Any) -> Any:
    """Return the result of the pickled function `packed` for an item; Dask calls this on a worker.
    ExperimentError if the worker's Python or wavefield differs from the run's, which `versions` names."""
    if own_versions() != versions:
        raise ExperimentError(
            f"the workers run {own_versions()} ({sys.executable}), but the run {versions}: start both from "
            "one environment"
        )
    set_up_worker()
    try:
        return _unpacked(packed)(item)
    except Exception as error:
        raise memory_error(error) or error from None


@functools.lru_cache(maxsize=1)
def _unpacked(packed: bytes) -> Work:
    """Return the function that was pickled into the bytes `packed`; the latest function is cached."""
    work: Work = pickle.loads(packed)
    return work


def own_versions() -> str:
    """Return the versions of Python (major and minor) and wavefield of this process, as text."""
    return f"Python {sys.version_info[0]}.{sys.version_info[1]}, wavefield {wavefield.__version__}"
