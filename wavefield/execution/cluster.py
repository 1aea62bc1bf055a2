"""Where chunks of steps are measured: in this process, in others of this machine, or on a Dask cluster."""

import os
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from wavefield.execution.cluster_settings import ClusterSettings
from wavefield.execution.memory import memory_error
from wavefield.execution.pool import MEASURING, Pool
from wavefield.execution.worker_settings import one_thread

_MOST_THREADS = 4  # of a run's own process

Work = Callable[[Any], Any]
MapUnordered = Callable[[Work, Sequence[Any]], Generator[tuple[Any, Any], None, None]]


def count_workers(workflow: ClusterSettings) -> int:
    """Number of workers that a workflow asks for, at most."""
    if workflow.cluster == "none":
        return 1
    if workflow.workers == "auto":
        return _cores()
    return workflow.workers if isinstance(workflow.workers, int) else workflow.workers.maximum


def threads_here(workflow: ClusterSettings) -> int:
    """Threads that a run takes in its own process while its workers have nothing to do yet or any more."""
    return min(count_workers(workflow), _cores(), _MOST_THREADS)


def _cores() -> int:
    """Of this machine, as far as this process may use them."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def open_cluster(
    workflow: ClusterSettings,
    logs: Path | None = None,
    ahead: bool = False,
    lasting: bool = False,
    imports: Sequence[str] = MEASURING,
) -> Iterator[MapUnordered]:
    """Give a function that maps work over items on workers that come and go with it."""
    count = count_workers(workflow)
    watched = bool(workflow.dashboard or workflow.performance_report)
    if workflow.cluster == "none" or (workflow.cluster == "local" and count == 1 and not watched):
        yield _map_here
    elif workflow.cluster == "local" and not watched:
        with Pool(count, workflow.memory_bytes, lasting, imports) as pool:
            if ahead:
                pool.start()
            yield pool.map_unordered
    else:
        from wavefield.execution.dask_cluster import open_dask_cluster

        folder = logs or Path("wavefield.jobs").absolute()
        with open_dask_cluster(workflow, count, folder, lasting) as map_unordered:
            yield map_unordered


def _map_here(work: Work, items: Sequence[object]) -> Generator[tuple[Any, Any], None, None]:
    with one_thread():
        for item in items:
            try:
                result: Any = work(item)
            except Exception as error:
                result = memory_error(error) or error
            yield item, result
