"""Waves of a cube computed on workers: as in one process, with the sums over segments taken by workers."""

import pickle
import tempfile
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wavefield.atomic_write import write_error, writing
from wavefield.errors import ExperimentError, RunStopped
from wavefield.execution.cluster import MapUnordered, open_cluster
from wavefield.execution.process import stop_signals, stopped_by
from wavefield.execution.run_log import jobs_folder, log_file
from wavefield.execution.workflow import Workflow

if TYPE_CHECKING:
    import xarray as xr

_WORKER_IMPORTS = ("wavefield.pipeline.analysis", "wavefield.waves.wave_analysis")


def analyze_on_workers(
    cube: str | Path, out: str | Path, workflow: str | Path | Workflow, **options: Any
) -> "xr.DataTree":
    """Compute the waves of a cube on the workers of a workflow, bit for bit as `wavefield.analyze` does.

    Parameters
    ----------
    cube : path
        A cube's store, on a disk that all workers see.
    out : path
        Zarr store to write, on such a disk: partial sums are stored next to it and removed at the end.
    workflow : path or Workflow
        Where to work.
    **options
        Further keywords of `wavefield.analyze`: probes, segment, depth and others.

    Returns
    -------
    DataTree
        As `wavefield.analyze` gives it.

    Raises
    ------
    CubeError, StoreError
        As `wavefield.analyze` raises them.
    ExperimentError
        If the cluster cannot be started or its scheduler not be reached.
    RunStopped
        If it was interrupted, by Ctrl-C, a signal or the workflow's time limit.

    Notes
    -----
    The record is cut into chains of eight segments whatever the workers are; each chain is summed by one
    worker, and the sums of the chains are added in their order.

    Examples
    --------
    >>> import wavefield as wf
    >>> workflow = wf.Workflow(cluster="local", workers=4)
    >>> waves = wf.analyze_on_workers("cube.zarr", "cube_waves.zarr", workflow, depth=0.7)  # doctest: +SKIP
    >>> waves["coherence"].C_tot.dims  # doctest: +SKIP
    ('k',)
    """
    if not isinstance(workflow, Workflow):
        workflow = Workflow.load(workflow)
    source, target = Path(cube).absolute(), Path(out).absolute()
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        place = tempfile.TemporaryDirectory(prefix=f".{target.name}.", suffix=".partial", dir=target.parent)
    with place as folder, log_file(target), stop_signals(workflow.time_limit_seconds):
        try:
            with open_cluster(workflow, jobs_folder(target), _WORKER_IMPORTS) as map_unordered:
                from wavefield.waves.wave_analysis import analyze  # while the workers start

                return analyze(
                    source, target, each=partial(_in_order, map_unordered, Path(folder)), **options
                )
        except KeyboardInterrupt as stop:
            raise RunStopped(
                f"{stopped_by(stop)}; nothing was written, and the same command begins again"
            ) from None


def _through_disk(work: Callable[[Any], Any], folder: Path, numbered: tuple[int, Path]) -> Path:
    """Do the work for an item in a file and write the result to a file: both are too large for messages."""
    return _dump(work(_load(numbered[1])), folder)


def _load(path: Path) -> object:
    try:
        with path.open("rb") as stream:
            return pickle.load(stream)
    except FileNotFoundError:
        raise _not_shared(path.parent.parent) from None


def _dump(item: object, folder: Path) -> Path:
    path = folder / uuid.uuid4().hex
    try:
        with path.open("wb") as stream:
            pickle.dump(item, stream, pickle.HIGHEST_PROTOCOL)
    except FileNotFoundError:
        raise _not_shared(folder.parent) from None
    except OSError as error:
        raise write_error(folder.parent, error) from None
    return path


def _not_shared(folder: Path) -> ExperimentError:
    return ExperimentError(
        f"a worker does not see {folder}: write the waves to a disk that all workers share"
    )


def _in_order(
    map_unordered: MapUnordered, folder: Path, work: Callable[[Any], object], items: Sequence[object]
) -> Iterator[Any]:
    """Yield results in the order of their items; those that come early wait on the disk."""
    waiting: dict[int, Path] = {}
    requested = 0
    if not items:
        return
    paths = list(enumerate(_dump(item, folder) for item in items))
    with closing(map_unordered(partial(_through_disk, work, folder), paths)) as results:
        for (number, _), result in results:
            if isinstance(result, BaseException):
                raise result
            waiting[number] = result
            while requested in waiting:
                path = waiting.pop(requested)
                yield _load(path)
                path.unlink()
                requested += 1
