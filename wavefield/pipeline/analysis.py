"""Compute the waves of a cube, in this process or on workers, and write the smoothed fields of a cube."""

import os
import pickle
import tempfile
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wavefield.atomic_write import Product, atomic, check_writable, write_error, writing
from wavefield.errors import CubeError, ExperimentError, RunStopped, StoreError
from wavefield.execution.cluster import MapUnordered, open_cluster
from wavefield.execution.process import stop_signals, stopped_by
from wavefield.execution.run_files import jobs_folder, log_file
from wavefield.execution.workflow import Workflow

if TYPE_CHECKING:
    import xarray as xr

_WORKER_IMPORTS = ("wavefield.pipeline.analysis", "wavefield.waves.analysis")


def _open(cube: "str | Path | xr.Dataset") -> "xr.Dataset":
    import xarray as xr

    if isinstance(cube, xr.Dataset):
        return cube
    if not isinstance(cube, str | Path):
        raise CubeError(f"analyze needs a cube or the path of one, not a {type(cube).__name__}")
    from wavefield.store.cube import open_stored
    from wavefield.store.read import find_store, is_cube

    cube = find_store(cube)
    if is_cube(cube):  # written by a run
        return open_stored(cube, chunks=None)
    try:
        out: xr.Dataset = xr.open_zarr(cube, chunks=None, consolidated=False)
        return out
    except Exception as error:  # whatever a library makes of damaged or foreign files
        raise StoreError(f"{cube} cannot be read as a cube: {error}") from None


def analyze(
    cube: "str | Path | xr.Dataset",
    out: str | Path | None = None,
    *,
    workflow: str | Path | Workflow | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> "xr.DataTree":
    """Compute the waves of a cube: spectra, coherence, kinematics, statistics, dispersion and more.

    Memory is bounded, whatever the length of the cube. The result does not depend on the cube's chunks.

    Parameters
    ----------
    cube : path or Dataset
        Store of a cube, or a Dataset with the elevation z (m), its rate of change z_t (m/s) and the velocity
        u, v, w (m/s) over (time, y, x).
    out : path, optional
        Zarr store to write. An existing store is replaced once the new one is complete.
    workflow : path or Workflow, optional
        Number and kind of workers, such as ``wf.Workflow(cluster="local", workers=4)``; the result is exactly
        the same. Cube and ``out`` must then be stores on a disk that all workers see. By default this process
        does the work.
    progress : callable, optional
        Called with the number of parts that are done and the number of all parts.
    **options
        Any of the following:

        ``probes`` : Dataset
            Wave probes (`wavefield.read_probes`).
        ``segment`` : int
            Number of steps of a Welch segment; by default chosen from the length of the record.
        ``depth`` : float
            Depth of the water, m; by default the attribute ``water_depth`` of the cube, or deep.
        ``gain`` : path, Dataset or False
            Measured over true amplitude of waves. The spectra are corrected for it where it is half or more;
            shorter waves are not valid. By default the response stored with the cube; False leaves the
            spectra as they were measured.
        ``current`` : tuple of float
            Velocity of the water along x and y, m/s, used if the spectra do not allow a fit of the current.

    Returns
    -------
    DataTree
        One group for each subject, such as "spectra" and "statistics". The documentation's page on formats
        lists the variables.

    Raises
    ------
    CubeError
        If the cube lacks a variable, is shorter than a segment, or has uneven time steps; if no rectangle of
        nodes is fully measured; or if the probes did not record while the cameras did.
    StoreError
        If the cube or the gain cannot be read or the store cannot be written.
    ExperimentError
        If the workers cannot be started, do not see the disk, or their scheduler cannot be reached.
    RunStopped
        If Ctrl-C, a signal or the workflow's time limit has stopped the workers. Nothing is written then.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> t, y, x = np.arange(64) * 0.05, np.arange(16) * 0.05, np.arange(20) * 0.05
    >>> noise = np.random.default_rng(0).standard_normal((5, 64, 16, 20))
    >>> wave = 0.01 * np.cos(12.3 * x - 10.98 * t[:, None, None] + 0 * y[:, None])
    >>> names, axes = ("z", "z_t", "u", "v", "w"), {"time": t, "y": y, "x": x}
    >>> fields = {
    ...     name: (tuple(axes), wave + 1e-3 * n, {"units": "m" if name == "z" else "m s-1"})
    ...     for name, n in zip(names, noise)
    ... }
    >>> waves = analyze(xr.Dataset(fields, axes), segment=16)
    >>> sorted({"coherence", "spectra", "statistics"} & set(waves))
    ['coherence', 'spectra', 'statistics']
    >>> waves["spectra"].E.sel(quantity="w").dims
    ('omega', 'k')
    """
    if workflow is None:
        return _analyze(cube, out, progress=progress, **options)
    if out is None or not isinstance(cube, str | Path):
        raise CubeError("with a workflow, analyze needs the path of a cube and the path of a store to write")
    if not isinstance(workflow, Workflow):
        workflow = Workflow.load(workflow)
    source, target = Path(cube).absolute(), Path(out).absolute()
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        place = tempfile.TemporaryDirectory(prefix=f".{target.name}.", suffix=".partial", dir=target.parent)
    with place as folder, log_file(target), stop_signals(workflow.time_limit_seconds):
        try:
            with open_cluster(workflow, jobs_folder(target), _WORKER_IMPORTS) as map_unordered:
                import wavefield.waves.analysis  # noqa: F401 while the workers start

                each = partial(_in_order, map_unordered, Path(folder))
                return _analyze(source, target, each=each, progress=progress, **options)
        except KeyboardInterrupt as stop:
            raise RunStopped(
                f"{stopped_by(stop)}; nothing was written, and the same command begins again"
            ) from None


def _analyze(cube: "str | Path | xr.Dataset", out: str | Path | None, **options: Any) -> "xr.DataTree":
    """Compute the waves of a cube, and write them to the store ``out`` unless that is None.
    Options are those of `analyze`, and ``each(work, items)``, which yields results in the order of items."""
    from wavefield.store.recipe import source_of, state_of
    from wavefield.store.results import WAVES, write_waves
    from wavefield.waves.analysis import analyze as waves_of

    opened = _open(cube)
    inputs = [opened.encoding.get("source"), cube, options.get("gain")]
    if out is not None:
        check_writable(out, Product(WAVES, source_of(opened)), inputs=inputs)
    tree = waves_of(opened, **options)
    tree.attrs["cube"] = state_of(opened)
    if out is not None:
        write_waves(tree, Path(out), source_of(opened), inputs)
    return tree


def _through_disk(work: Callable[[Any], Any], folder: Path, numbered: tuple[int, Path]) -> Path:
    """Apply `work` to an item that is pickled in a file, and pickle the result in `folder`; return its path.
    `numbered` is (number of the item, its file). Items are too large for messages between processes."""
    try:
        item = pickle.loads(numbered[1].read_bytes())
    except FileNotFoundError:
        raise ExperimentError(
            f"a worker does not see {folder.parent}: write the waves to a disk that all workers share"
        ) from None
    return _dump(work(item), folder)


def _dump(item: object, folder: Path) -> Path:
    path = folder / uuid.uuid4().hex
    try:
        with path.open("wb") as stream:
            pickle.dump(item, stream, pickle.HIGHEST_PROTOCOL)
    except OSError as error:
        raise write_error(folder.parent, error) from None
    return path


def _in_order(
    map_unordered: MapUnordered, folder: Path, work: Callable[[Any], object], items: Sequence[object]
) -> Iterator[Any]:
    """Apply `work` to the items on workers, and yield the results in the order of the items.
    Items and results pass through files in `folder`, in which results that are ready early are kept."""
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
                yield pickle.loads(path.read_bytes())
                path.unlink()
                requested += 1


def write_smoothed(
    store: Path, output: Path | None = None, progress: Callable[[int, int], None] | None = None
) -> Path:
    """Write the smoothed fields of a cube (`wavefield.smooth`) to a Zarr store, and return its path.
    By default `output` is next to the cube `store`. `progress` is called with steps done and all steps."""
    import zarr

    from wavefield.store import beside
    from wavefield.store.cube import open_cube
    from wavefield.store.recipe import source_of, state_of
    from wavefield.variables import CUBE_DIMS
    from wavefield.waves.smooth import smooth

    output = output or beside(store, "smooth", ".zarr")
    cube = open_cube(store)
    product = Product("smoothed fields", source_of(cube))
    check_writable(output, product, inputs=[store])
    found = smooth(cube).chunk(time=cube.chunks["time"][0]).drop_encoding()
    found = found.drop_vars([name for name in found.coords if name not in CUBE_DIMS])
    found.attrs |= {"title": f"smoothed fields of {store.name}", "cube": state_of(cube)}
    steps, at_a_time = found.sizes["time"], found.chunks["time"][0] * (os.cpu_count() or 1)
    with atomic(output, product, inputs=[store]) as draft:
        for start in range(0, steps, at_a_time):
            part = found.isel(time=slice(start, start + at_a_time))
            part.to_zarr(
                draft, mode=None if start else "w", append_dim="time" if start else None, consolidated=False
            )
            if progress:
                progress(min(start + at_a_time, steps), steps)
        with warnings.catch_warnings():  # readers warn without it, zarr warns with it
            warnings.filterwarnings("ignore", message="Consolidated metadata")
            zarr.consolidate_metadata(draft)
    return output
