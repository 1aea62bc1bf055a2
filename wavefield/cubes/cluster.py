"""Where blocks are measured: in this process, in others of this machine, or on a Dask cluster."""

import os
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from wavefield.cubes.pool import Pool
from wavefield.cubes.worker_settings import one_thread
from wavefield.cubes.workflow import Workflow

_MOST_THREADS = 4  # of a run's own process

Work = Callable[[Any], Any]
MapUnordered = Callable[[Work, Sequence[Any]], Generator[tuple[Any, Any], None, None]]


def count_workers(workflow: Workflow) -> int:
    """Number of workers that a workflow asks for, at most.

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
        return _cores()
    return workflow.workers if isinstance(workflow.workers, int) else workflow.workers.maximum


def threads_here(workflow: Workflow) -> int:
    """Threads that a run takes in its own process while its workers have nothing to do yet or any more.

    Parameters
    ----------
    workflow : Workflow
        The workflow.

    Returns
    -------
    int
        No more than it has workers, and few: each holds the images of an instant.
    """
    return min(count_workers(workflow), _cores(), _MOST_THREADS)


def _cores() -> int:
    """Of this machine, as far as this process may use them."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def open_cluster(
    workflow: Workflow,
    logs: Path | None = None,
    ahead: bool = False,
    lasting: bool = False,
    forked: str = "wavefield.cubes.forked",
) -> Iterator[MapUnordered]:
    """Give a function that maps work over items on workers that come and go with it.

    Parameters
    ----------
    workflow : Workflow
        Where to work.
    logs : path, optional
        Folder for what the workers of a cluster say, seen by all its machines; by default here.
    ahead : bool
        Start processes of this machine at once, while the caller prepares their work.
    lasting : bool
        Keep the workers for more work until the caller leaves; else they do work once, and end with it.
    forked : str
        Module that imports what processes of this machine need.

    Yields
    ------
    map_unordered : callable
        ``map_unordered(work, items)`` iterates over (item, result or exception) as they are done. It raises
        ExperimentError if the cluster cannot be started or the scheduler not be reached.
    """
    count = count_workers(workflow)
    watched = bool(workflow.dashboard or workflow.performance_report)
    if workflow.cluster == "none" or (workflow.cluster == "local" and count == 1 and not watched):
        yield _map_here
    elif workflow.cluster == "local" and not watched:
        with Pool(count, workflow.memory_bytes, lasting, forked) as pool:
            if ahead:
                pool.start()
            yield pool.map_unordered
    else:
        from wavefield.cubes.dask_cluster import open_dask_cluster

        folder = logs or Path("wavefield.jobs").absolute()
        with open_dask_cluster(workflow, count, folder, lasting) as map_unordered:
            yield map_unordered


def _map_here(work: Work, items: Sequence[Any]) -> Generator[tuple[Any, Any], None, None]:
    with one_thread():
        for item in items:
            try:
                result: Any = work(item)
            except Exception as error:
                result = error
            yield item, result
