"""Workers of a Dask cluster: one that runs already, or one that comes and goes with the run."""

import itertools
import logging
import math
import queue
import sys
import time
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import dask

import wavefield
from wavefield.errors import ExperimentError, StoreError, WavefieldError
from wavefield.execution import slurm
from wavefield.execution.cluster_settings import ClusterSettings
from wavefield.execution.dask_settings import (
    configured,
    dashboard_address,
    dask_settings,
    needs_tls,
    of_jobqueue,
    temporary_credentials,
)
from wavefield.execution.pool import portable
from wavefield.execution.signals import deferred_signals
from wavefield.execution.slurm_queue import QueueWatch
from wavefield.execution.worker_settings import settle_worker

if TYPE_CHECKING:  # seconds to import
    from distributed import Client

log = logging.getLogger("wavefield.run")
Watch = Callable[[], None]
Work = Callable[[Any], Any]
Results = Generator[tuple[Any, Any], None, None]

_SCHEDULER_TIMEOUT = "20s"  # for a scheduler that should be running already
_POLL_SECONDS = 2.0  # without news, after which the workers are checked
_SILENT_SECONDS = 16.0  # without a heartbeat, after which a worker is reported
_HEARTBEAT_CHECK_SECONDS = 8.0  # between checks, which take long messages where workers are many
_TASKS_PER_WORKER = 2  # that the scheduler holds: one at work, one ready
_MAX_ITEMS_PER_TASK = 8
_TASKS_LEFT = 16  # for each worker: with fewer to come, tasks become smaller, so that all end together


@dataclass(frozen=True)
class Task:
    """Work as it is sent to a worker: done only by the client's Python and version."""

    work: Work  # The work
    versions: str  # Of the client's Python and wavefield

    def __call__(self, items: Sequence[object]) -> list[Any]:
        """Do the work for some items."""
        here, client = own_versions(), self.versions
        if here != client:
            raise ExperimentError(
                f"the workers run {here} ({sys.executable}), but the run {client}: start both from one "
                "environment"
            )
        settle_worker()
        out = []
        for item in items:
            try:
                out.append(self.work(item))
            except Exception as error:
                return [*out, portable(error)]
        return out


def own_versions() -> str:
    """Versions of Python (major and minor) and wavefield of this process."""
    return f"Python {sys.version_info[0]}.{sys.version_info[1]}, wavefield {wavefield.__version__}"


@contextmanager
def open_dask_cluster(
    workflow: ClusterSettings, count: int, logs: Path, lasting: bool = False
) -> Iterator[Callable[[Work, Sequence[Any]], Results]]:
    """Give a function that maps work over items on a Dask cluster that it starts and ends."""
    if workflow.cluster == "slurm" or of_jobqueue(workflow):
        slurm.import_jobqueue()
    started: list[tuple[Any, Watch]] = []
    with ExitStack() as stack:

        def map_unordered(work: Work, items: Sequence[object]) -> Results:
            # the workers end with their work, while the caller still guards the store
            with nullcontext() if lasting else stack:
                if not started:
                    started.append(_start(workflow, count, logs, stack))
                client, watch = started[0]
                yield from _map_on(client, work, items, count, watch)

        yield map_unordered


def _start(workflow: ClusterSettings, count: int, logs: Path, stack: ExitStack) -> tuple[Any, Watch]:
    with deferred_signals():  # what is closed while it starts prints tracebacks from other threads
        settings = dask_settings(workflow)
        if needs_tls(workflow):
            secrets = stack.enter_context(temporary_credentials(logs))
            settings = dask.config.merge(secrets, settings)
        stack.enter_context(configured(settings))
        client, watch = _connect(workflow, count, logs, settings, stack)
    log.info("scheduler: %s", client.scheduler.address)
    if client.dashboard_link and workflow.dashboard:
        log.info("dashboard: %s", client.dashboard_link)
    if workflow.performance_report:
        from distributed import performance_report

        stack.enter_context(client.as_current())
        stack.enter_context(performance_report(filename=workflow.performance_report))
    return client, watch


def _connect(
    workflow: ClusterSettings, count: int, logs: Path, settings: dict[str, Any], stack: ExitStack
) -> tuple[Any, Watch]:
    from distributed import Client

    watch: Watch = lambda: None  # noqa: E731
    if workflow.cluster == "address":
        try:
            client = Client(workflow.address, timeout=_SCHEDULER_TIMEOUT, set_as_default=False)
        except OSError as error:
            raise ExperimentError(
                f"no scheduler answers at {workflow.address} ({error}); start one with "
                "`dask scheduler`, or correct `address` in the workflow"
            ) from None
        stack.enter_context(client)
        return client, _WithoutWorkers(client, workflow.address or "")
    if workflow.cluster == "slurm":
        cluster = stack.enter_context(slurm.slurm_cluster(workflow, logs, settings))
        fewest, most = slurm.count_jobs(workflow)
        cluster.adapt(minimum_jobs=fewest, maximum_jobs=most)  # jobs that end or die are asked for again
        log.info("asked Slurm for %d jobs; the run begins when the first starts", fewest)
        watch = QueueWatch(cluster, Path(workflow.slurm.get("log_directory", logs)))
    elif workflow.cluster == "dask":
        cluster = stack.enter_context(_deploy(workflow, settings))
    else:
        cluster = stack.enter_context(_local(workflow, count))
    client = Client(cluster, timeout="60s", set_as_default=False)
    return stack.enter_context(client), watch


def _local(workflow: ClusterSettings, count: int) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=count,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        memory_limit=workflow.memory_bytes or "auto",
        dashboard_address=dashboard_address(workflow),
        worker_dashboard_address="127.0.0.1:0",
        preload=["wavefield.pipeline.dask_preload"],
        silence_logs=logging.ERROR,
    )


def _deploy(workflow: ClusterSettings, settings: dict[str, Any]) -> Any:
    """Start a cluster of any class that deploys Dask."""
    name, options = workflow.deploy or "", dict(workflow.options)
    if of_jobqueue(workflow):  # its jobs do not have our configuration, such as TLS
        own = list(options.get("job_script_prologue", []))
        options["job_script_prologue"] = slurm.environment_lines(settings) + own
    module, _, attribute = name.rpartition(".")
    try:
        kind = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ExperimentError(
            f"the workflow's `deploy`: {name!r} cannot be imported ({error}); install its package, or "
            "correct the name, such as distributed.SSHCluster"
        ) from None
    try:
        cluster = kind(**options)
    except Exception as error:  # each library has exceptions of its own
        raise ExperimentError(
            f"the workflow's `deploy`: {name} does not start: {type(error).__name__}: {error}; see "
            "`options`, which are its keywords"
        ) from error
    if isinstance(workflow.workers, int):
        cluster.scale(workflow.workers)
    elif workflow.workers != "auto":
        cluster.adapt(minimum=workflow.workers.minimum, maximum=workflow.workers.maximum)
    return cluster


class _WithoutWorkers:
    """Reports, once, that a scheduler has no workers."""

    def __init__(self, client: "Client", address: str) -> None:
        self._client, self._address, self._reported = client, address, False

    def __call__(self) -> None:
        if not self._reported and not self._client.nthreads():
            self._reported = True
            log.warning(
                "the scheduler at %s has no workers; the run begins when the first is started: "
                "`dask worker %s --nthreads 1`",
                self._address,
                self._address,
            )


class _SilentWorkers:
    """Reports workers that send no heartbeat, before the scheduler replaces them (`worker-ttl`)."""

    def __init__(self, client: "Client") -> None:
        self._client = client
        # by address: last heartbeat by the worker's clock, and when it was new here
        self._heartbeats: dict[str, tuple[float, float]] = {}
        self._checked = -math.inf
        self._reported: set[str] = set()

    def check(self) -> None:
        """Log a warning, once, for each worker that has been silent for a while."""
        now = time.monotonic()
        if now - self._checked < _HEARTBEAT_CHECK_SECONDS:
            return
        late = now - self._checked > 3 * _HEARTBEAT_CHECK_SECONDS  # this process was itself suspended
        self._checked = now
        with deferred_signals():
            workers = self._client.scheduler_info()["workers"]
        for address, worker in workers.items():
            sign, since = self._heartbeats.get(address, (None, now))
            if late or worker["last_seen"] != sign:
                self._heartbeats[address] = worker["last_seen"], now
                self._reported.discard(address)
            elif now - since >= _SILENT_SECONDS and address not in self._reported:
                self._reported.add(address)
                log.warning(
                    "the worker %s (%s) has given no sign of life for %.0f s: it is suspended, or machine "
                    "or network do not answer; Dask replaces it when its `worker-ttl` is over",
                    worker.get("name", ""),
                    address,
                    _SILENT_SECONDS,
                )


def _map_on(client: "Client", work: Work, items: Sequence[object], workers: int, watch: Watch) -> Results:
    """Map work over items, so that the scheduler never holds more than a few tasks for each worker."""
    from distributed import CancelledError

    tasks = _Tasks(client, Task(work, own_versions()), items, workers)
    lost = StoreError("the scheduler was lost; what is done is kept: run the same command again to go on")
    silence = _SilentWorkers(client)
    try:
        tasks.submit()
        while tasks.futures:
            watch()
            silence.check()
            done = tasks.wait()
            gone = {future.status for future in done} - {"finished", "error"}
            if "cancelled" in gone or (gone and client.status != "running"):
                raise lost
            if done:
                with deferred_signals():
                    results = tasks.fetch(done)
                    tasks.submit()
                for index, result in results:
                    yield items[index], _as_sentence(result)
    except (OSError, CancelledError) as error:  # the connection broke while a report was fetched
        raise lost from error
    finally:
        if tasks.futures and client.status == "running":
            client.cancel(list(tasks.futures), force=True)


class _Tasks:
    """Items as tasks: several in one while many are left, so that a scheduler of many workers keeps up.
    What ended while the last results were fetched is fetched at once, and as much submitted at once.
    """

    def __init__(self, client: "Client", task: Task, items: Sequence[object], workers: int) -> None:
        self._client, self._task, self._items = client, task, items
        self._workers = max(workers, 1)
        self._news: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._left = deque(range(len(items)))
        self._alone: set[int] = set()  # items of a task that ended with its workers: which of them was it?
        self._number = itertools.count()
        self._mark = uuid.uuid4().hex  # an address would come again, and with it the results of other items
        self.futures: dict[Any, list[int]] = {}

    def submit(self) -> None:
        """Submit until the scheduler holds enough."""
        room = min(_TASKS_PER_WORKER * self._workers - len(self.futures), len(self._left))
        some = [indices for indices in (self._take() for _ in range(room)) if indices]
        if not some:
            return
        keys = [f"chunks-{next(self._number)}-{self._mark}" for _ in some]
        batches = [[self._items[index] for index in indices] for indices in some]
        for future, indices in zip(self._client.map(self._task, batches, pure=False, key=keys), some):
            self.futures[future] = indices
            future.add_done_callback(self._news.put)

    def _take(self) -> list[int]:
        if self._left and self._left[0] in self._alone:
            return [self._left.popleft()]
        size = min(max(len(self._left) // (_TASKS_LEFT * self._workers), 1), _MAX_ITEMS_PER_TASK)
        return [self._left.popleft() for _ in range(min(size, len(self._left)))]

    def wait(self) -> list[Any]:
        """Tasks that have ended; none if nothing happens for a while."""
        try:
            done = [self._news.get(timeout=_POLL_SECONDS)]
        except queue.Empty:
            return []
        while not self._news.empty():
            done.append(self._news.get())
        return done

    def fetch(self, done: Sequence[Any]) -> list[tuple[int, Any]]:
        """Results of tasks that have ended, item by item; what was not done goes back to what is left."""
        from distributed import CancelledError

        finished = [future for future in done if future.status == "finished"]
        gone = [future for future in done if future.status not in ("finished", "error")]
        try:
            results = dict(zip(finished, self._client.gather(finished))) if finished else {}
        except CancelledError:
            results, gone = {}, gone + finished
        out: list[tuple[int, Any]] = []
        for future in done:
            indices = self.futures.pop(future)
            if future in results:
                out += zip(indices, results[future])
                self._left.extendleft(reversed(indices[len(results[future]) :]))
            elif future in gone:  # its worker ended before the results were fetched
                self._left.extendleft(reversed(indices))
            elif len(indices) > 1:
                self._alone.update(indices)
                self._left.extendleft(reversed(indices))
            else:
                out.append((indices[0], future.exception()))
        return out


def _as_sentence(result: object) -> Any:
    """Dask's error for a task that never ran, as a sentence."""
    from distributed import KilledWorker

    if isinstance(result, WavefieldError):
        return result
    if isinstance(result, KilledWorker):
        return StoreError(
            f"{result.allowed_failures} workers ended while they worked on it: if memory ran out, give more "
            "`memory` or a smaller `steps_per_block` in the workflow; if their time did, give them more"
        )
    missing = isinstance(result, ModuleNotFoundError) and (result.name or "").startswith("wavefield")
    if missing or "deserialization" in str(result):
        return ExperimentError(
            f"scheduler or workers cannot load wavefield {wavefield.__version__} ({result}); start them from "
            "an environment in which it is installed"
        )
    return result
