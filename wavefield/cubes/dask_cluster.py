"""Workers of a Dask cluster: one that runs already, or one that comes and goes with the run."""

import logging
import queue
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import wavefield
from wavefield.cubes import slurm
from wavefield.cubes.dask_settings import (
    configured,
    dashboard_address,
    dask_settings,
    temporary_credentials,
    wants_tls,
)
from wavefield.cubes.interrupts import undisturbed
from wavefield.cubes.slurm_watch import Watch
from wavefield.cubes.worker_settings import settle_worker
from wavefield.cubes.workflow import Workflow
from wavefield.errors import ExperimentError, StoreError, WavefieldError

log = logging.getLogger("wavefield.run")
Look = Callable[[], None]

_SCHEDULER_TIMEOUT = "20s"  # for a scheduler that should be running already
_LOOK_AFTER = 2.0  # seconds without news after which the workers are looked after
_HELD = 2  # tasks that the scheduler holds for each worker: one at work, one ready


@dataclass(frozen=True)
class Task:
    """Work as it is sent to a worker: done only by the client's Python and version.

    Parameters
    ----------
    work : callable
        The work.
    python : tuple of int
        Major and minor version of the client's Python.
    version : str
        Of the client's wavefield.
    """

    work: Callable[[Any], Any]
    python: tuple[int, ...]
    version: str

    def __call__(self, item: Any) -> Any:
        """Do the work for one item.

        Parameters
        ----------
        item : object
            What the work is called with.

        Returns
        -------
        object
        """
        here, client = sys.version_info[:2], f"Python {_dotted(self.python)}, wavefield {self.version}"
        if (here, wavefield.__version__) != (self.python, self.version):
            raise ExperimentError(
                f"the workers run Python {_dotted(here)}, wavefield {wavefield.__version__} "
                f"({sys.executable}), but the run {client}: start both from one environment"
            )
        settle_worker()
        return self.work(item)


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))


@contextmanager
def open_dask_cluster(
    workflow: Workflow, count: int, logs: Path
) -> Iterator[Callable[[Callable[[Any], Any], Sequence[Any]], Generator[tuple[Any, Any], None, None]]]:
    """Give a function that maps work over items, once, on a Dask cluster that it starts and ends.

    Parameters
    ----------
    workflow : Workflow
        Where to work.
    count : int
        Most workers that it asks for.
    logs : path
        Folder for what the workers of a cluster say, and for its credentials: all machines see it.

    Yields
    ------
    map_unordered : callable
        As that of `wavefield.cubes.cluster.open_cluster`.
    """
    if workflow.cluster == "slurm":
        slurm.import_jobqueue()
    with ExitStack() as stack:

        def map_unordered(
            work: Callable[[Any], Any], items: Sequence[Any]
        ) -> Generator[tuple[Any, Any], None, None]:
            with stack:  # the workers end with their work, while the caller still guards the store
                with undisturbed():  # what is closed while it starts prints tracebacks from other threads
                    settings = dask_settings(workflow)
                    if wants_tls(workflow):
                        secrets = stack.enter_context(temporary_credentials(logs))
                        settings = _merged(secrets, settings)
                    stack.enter_context(configured(settings))
                    client, watch = _connect(workflow, count, logs, settings, stack)
                log.info("scheduler: %s", client.scheduler.address)
                if client.dashboard_link and workflow.dashboard:
                    log.info("dashboard: %s", client.dashboard_link)
                if workflow.performance_report:
                    from distributed import performance_report

                    stack.enter_context(client.as_current())
                    stack.enter_context(performance_report(filename=workflow.performance_report))
                yield from _map_on(client, work, items, _HELD * count, watch)

        yield map_unordered


def _merged(*settings: dict[str, Any]) -> dict[str, Any]:
    import dask

    out: dict[str, Any] = dask.config.merge(*settings)
    return out


def _connect(
    workflow: Workflow, count: int, logs: Path, settings: dict[str, Any], stack: ExitStack
) -> tuple[Any, Look]:
    from distributed import Client

    watch: Look = lambda: None  # noqa: E731
    if workflow.cluster == "address":
        try:
            client = Client(workflow.address, timeout=_SCHEDULER_TIMEOUT, set_as_default=False)
        except OSError as error:
            raise ExperimentError(
                f"no scheduler answers at {workflow.address} ({error}); start one with "
                "`dask scheduler`, or correct `address` in the workflow"
            ) from None
        stack.enter_context(client)
        return client, _Patience(client, workflow.address or "")
    if workflow.cluster == "slurm":
        cluster = stack.enter_context(slurm.slurm_cluster(workflow, logs, settings))
        fewest, most = slurm.count_jobs(workflow)
        cluster.adapt(minimum_jobs=fewest, maximum_jobs=most)  # jobs that end or die are asked for again
        log.info("asked Slurm for %d jobs; the run begins when the first starts", fewest)
        watch = Watch(cluster, Path(workflow.slurm.get("log_directory", logs)))
    elif workflow.cluster == "dask":
        cluster = stack.enter_context(_deploy(workflow))
    else:
        cluster = stack.enter_context(_local(workflow, count))
    client = Client(cluster, timeout="60s", set_as_default=False)
    return stack.enter_context(client), watch


def _local(workflow: Workflow, count: int) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=count,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        memory_limit=workflow.memory_bytes or "auto",
        dashboard_address=dashboard_address(workflow),
        worker_dashboard_address="127.0.0.1:0",
        preload=["wavefield.cubes.dask_preload"],
        silence_logs=logging.ERROR,
    )


def _deploy(workflow: Workflow) -> Any:
    """Start a cluster of any class that deploys Dask."""
    name = workflow.deploy or ""
    module, _, attribute = name.rpartition(".")
    try:
        kind = getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ExperimentError(
            f"the workflow's `deploy`: {name!r} cannot be imported ({error}); install its package, or "
            "correct the name, such as distributed.SSHCluster"
        ) from None
    try:
        cluster = kind(**workflow.options)
    except Exception as error:  # each library has exceptions of its own
        raise ExperimentError(
            f"the workflow's `deploy`: {name} does not start: {type(error).__name__}: {error}; look at "
            "`options`, which are its keywords"
        ) from error
    if isinstance(workflow.workers, int):
        cluster.scale(workflow.workers)
    elif workflow.workers != "auto":
        cluster.adapt(minimum=workflow.workers.minimum, maximum=workflow.workers.maximum)
    return cluster


class _Patience:
    """Says, once, that a scheduler has no workers."""

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address, self._said = client, address, False

    def __call__(self) -> None:
        if not self._said and not self._client.nthreads():
            self._said = True
            log.warning(
                "the scheduler at %s has no workers; the run begins when the first is started: "
                "`dask worker %s --nthreads 1`",
                self._address,
                self._address,
            )


def _map_on(
    client: Any, work: Callable[[Any], Any], items: Sequence[Any], held: int, watch: Look
) -> Generator[tuple[Any, Any], None, None]:
    """Map work over items, so that the scheduler never holds more than a few tasks for each worker."""
    from distributed import CancelledError

    task = Task(work, sys.version_info[:2], wavefield.__version__)
    news: queue.SimpleQueue[Any] = queue.SimpleQueue()
    futures: dict[Any, int] = {}
    waiting = iter(range(len(items)))

    def submit() -> None:
        for index in waiting:
            future = client.submit(task, items[index], pure=False, key=f"block-{index}-{id(items)}")
            futures[future] = index
            future.add_done_callback(news.put)
            return

    lost = StoreError("the scheduler was lost; what is done is kept: run the same command again to go on")
    try:
        for _ in range(max(held, 1)):
            submit()
        while futures:
            watch()
            try:
                future = news.get(timeout=_LOOK_AFTER)
            except queue.Empty:
                continue
            if future.status not in ("finished", "error"):  # cancelled or lost with its scheduler
                raise lost
            with undisturbed():
                result: Any = future.result() if future.status == "finished" else future.exception()
            index = futures.pop(future)
            submit()
            yield items[index], _understood(result)
    except (OSError, CancelledError) as error:  # the connection broke while a report was fetched
        raise lost from error
    finally:
        if futures and client.status == "running":
            client.cancel(list(futures), force=True)


def _understood(result: Any) -> Any:
    """What Dask says of a task that never ran, as a sentence."""
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
