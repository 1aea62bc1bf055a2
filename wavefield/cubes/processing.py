"""Processing a whole experiment into a store, block by block, on one process or many.

Whatever stops a run (Ctrl-C, a time limit, a dead scheduler, a full disk), the same command goes on from the
ledger: only blocks that are not marked done are measured.
"""

import hashlib
import json
import logging
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wavefield.cubes.block import Block, make_block
from wavefield.cubes.cluster import count_workers, open_cluster, undisturbed
from wavefield.cubes.work import Work
from wavefield.cubes.workflow import Workflow
from wavefield.errors import ExperimentError, RunStopped, StoreError, WavefieldError
from wavefield.grid import Grid
from wavefield.measurement.algorithm import ALGORITHM
from wavefield.rig import Rig
from wavefield.rig.resolution import pixel_size
from wavefield.series import Experiment, FrameSeries
from wavefield.series.document import place_of, read_yaml
from wavefield.store.layout import Layout, create_store
from wavefield.store.ledger import Status, status
from wavefield.store.preview import create_preview
from wavefield.store.read import open_group, read_layout
from wavefield.store.recipe import Recipe, check_recipe
from wavefield.store.write import reset_blocks
from wavefield.variables import CUBE_FIELDS, TABLE, FrameStatus
from wavefield.whole_files import remove_leftovers, write_error
from wavefield.words import spell_time

log = logging.getLogger("wavefield.run")
ProgressFunction = Callable[[int, int, str], None]
MapFunction = Callable[[Work, Sequence[Block]], Generator[tuple[Block, Any]]]

_LONGEST_BLOCK = 100  # steps; a block costs one to two steps more for its three extra frames
_ENOUGH_FAILURES = 3  # blocks that fail before any succeeds: something is wrong with all of them


@dataclass(frozen=True)
class Prepared:
    """Everything that a run needs before it starts.

    Parameters
    ----------
    experiment : Experiment
        The experiment.
    series : mapping of str to FrameSeries
        Frames of the cameras that measure.
    rig : Rig
        Those cameras.
    grid : Grid
        The nodes.
    plan : wavefield.measurement.Plan
        The measurement.
    recipe : Recipe
        All of it as plain data.
    workflow : Workflow
        How to process.
    """

    experiment: Experiment
    series: Mapping[str, FrameSeries]
    rig: Rig
    grid: Grid
    plan: Any
    recipe: Recipe
    workflow: Workflow

    @property
    def steps(self) -> int:
        """Number of steps of the whole run."""
        return len(next(iter(self.series.values()))) - 1

    @property
    def step_bytes(self) -> int:
        """Bytes of the results of one step."""
        return self.plan.x.size * sum(np.dtype(TABLE[name].dtype).itemsize for name in CUBE_FIELDS)

    @property
    def block(self) -> int:
        """Steps per block of a new store."""
        workflow = self.workflow
        block = workflow.steps_per_block or choose_block(
            self.steps, count_workers(workflow), self.step_bytes, workflow.memory_bytes
        )
        return min(block, self.steps)


def run(
    experiment: str | Path | Experiment,
    entries: Sequence[str] = (),
    out: str | Path | None = None,
    *,
    rig: str | Path | Rig | None = None,
    workflow: str | Path | Workflow | None = None,
    progress: ProgressFunction | None = None,
    parameters: Mapping[str, str] | None = None,
) -> Status | list[Status]:
    """Process an experiment, or runs of a catalog, into a cube; goes on where an earlier run stopped.

    Parameters
    ----------
    experiment : path or Experiment
        Experiment file, or intake catalog of several.
    entries : sequence of str
        Runs of the catalog; all of them if left out.
    out : path, optional
        The store; by default ``cube.zarr`` beside the experiment file, or where the catalog says.
    rig : path or Rig, optional
        In place of the one that the experiment names.
    workflow : path or Workflow, optional
        Cluster and recipe; by default the processes of this machine.
    progress : callable, optional
        Called with steps done, steps of the whole run, and a sentence.
    parameters : mapping, optional
        Values for the catalog's parameters, such as the location of the data.

    Returns
    -------
    Status, or list of Status for a catalog

    Raises
    ------
    ExperimentError, RigError
        If something is missing or wrong, before anything is written.
    StoreError
        If the store was made with another recipe, or cannot be written.
    RunStopped
        If it was interrupted.

    Notes
    -----
    Results do not depend on the workflow: neither on the number of workers nor on the size of blocks.

    A store goes on with the recipe that it was begun with: settings, rig, grid, names of images, and the
    version of this package. Changed sources of one version and changed images of one name are not noticed.

    Worker processes start by importing the program that started them: in a script, call this below
    ``if __name__ == "__main__":``.
    """
    if not isinstance(experiment, Experiment) and is_catalog(experiment):
        from wavefield.cubes.catalog import run_catalog

        return run_catalog(
            experiment, entries, out, rig=rig, workflow=workflow, progress=progress, parameters=parameters
        )
    if entries:
        raise ExperimentError(f"{experiment} is an experiment, not a catalog: it has no run {entries[0]!r}")
    experiment, workflow = load_files(experiment, workflow)
    path = Path(out) if out is not None else experiment.resolve("cube.zarr")
    with ExitStack() as stack:
        with undisturbed():  # Ctrl-C inside an import may be lost
            map_unordered = stack.enter_context(open_cluster(workflow, ahead=not path.exists()))
            prepared = prepare(experiment, rig, workflow)
        return process(prepared, path, map_unordered, progress)


def is_catalog(path: str | Path) -> bool:
    """Whether a file is an intake catalog rather than an experiment.

    Parameters
    ----------
    path : path
        YAML.

    Returns
    -------
    bool
    """
    return "entries" in read_yaml(Path(path))


def prepare(
    experiment: str | Path | Experiment,
    rig: str | Path | Rig | None = None,
    workflow: str | Path | Workflow | None = None,
) -> Prepared:
    """Read and check everything that a run needs.

    Parameters
    ----------
    experiment : path or Experiment
        The experiment.
    rig : path or Rig, optional
        In place of the one that the experiment names.
    workflow : path or Workflow, optional
        How to process.

    Returns
    -------
    Prepared

    Raises
    ------
    ExperimentError, RigError
        If something is missing or wrong.
    """
    from wavefield.measurement import Plan

    experiment, workflow = load_files(experiment, workflow)
    series = experiment.open_frames()
    if not isinstance(rig, Rig):
        rig = experiment.load_rig(rig, series)
    used = {name: rig[name] for name in experiment.measuring_cameras}
    rig = replace(rig, cameras=used)
    grid = experiment.choose_grid(rig)
    if not any(expected_coverage(replace(rig, cameras={name: rig[name]}), grid) for name in rig):
        raise ExperimentError(
            f"{experiment.path}: no camera sees the grid (x {grid.x[0]:g} to {grid.x[1]:g} m, "
            f"y {grid.y[0]:g} to {grid.y[1]:g} m); correct `grid`, or leave it out to have it chosen"
        )
    settings = make_settings(experiment, workflow)
    plan = Plan(rig, grid, settings)
    series = {name: series[name] for name in used}
    recipe = make_recipe(experiment, series, rig, grid, settings, workflow.packing)
    return Prepared(experiment, series, rig, grid, plan, recipe, workflow)


def load_files(
    experiment: str | Path | Experiment, workflow: str | Path | Workflow | None
) -> tuple[Experiment, Workflow]:
    """Read the files that describe a run, as far as they are not read yet.

    Parameters
    ----------
    experiment : path or Experiment
        The experiment.
    workflow : path or Workflow, optional
        How to process; by default on the processes of this machine.

    Returns
    -------
    experiment : Experiment
        Read and checked.
    workflow : Workflow
        Likewise.
    """
    if not isinstance(experiment, Experiment):
        experiment = Experiment.load(experiment)
    if not isinstance(workflow, Workflow):
        workflow = Workflow() if workflow is None else Workflow.load(workflow)
    return experiment, workflow


def make_recipe(
    experiment: Experiment,
    series: Mapping[str, FrameSeries],
    rig: Rig,
    grid: Grid,
    settings: Any,
    packing: str = "float32",
) -> Recipe:
    """Collect the recipe of a run.

    Parameters
    ----------
    experiment : Experiment
        The experiment.
    series : mapping of str to FrameSeries
        Its frames.
    rig : Rig
        The cameras.
    grid : Grid
        The nodes.
    settings : wavefield.measurement.Settings
        The choices.
    packing : {"float32", "int16"}
        How values are stored.

    Returns
    -------
    Recipe
    """
    one = next(iter(series.values()))
    return Recipe(
        experiment=experiment.name,
        images={name: _images(experiment, name) for name in series},
        frames=(one.first, one.first + len(one) - 1),
        frame_rate=experiment.frame_rate,
        grid=asdict(grid),
        rig={name: rig[name].to_dict() for name in series},
        settings=settings.to_dict(),
        packing=packing,
        algorithm=ALGORITHM,
    )


def _images(experiment: Experiment, name: str) -> Any:
    section = experiment.cameras[name]
    images: Any = section.images
    if not isinstance(images, str) and len(images) > 20:  # a long list is told apart by its hash
        digest = hashlib.sha256(json.dumps(images).encode()).hexdigest()[:16]
        images = f"list of {len(images)} files, {digest}"
    return [images, section.offset, section.times]


def expected_coverage(rig: Rig, grid: Grid) -> float:
    """Share of the nodes that every camera sees while the water is at rest.

    Parameters
    ----------
    rig : Rig
        The cameras that measure.
    grid : Grid
        The nodes.

    Returns
    -------
    float
    """
    x, y = np.meshgrid(grid.x_nodes, grid.y_nodes)
    seen = np.ones(x.shape, bool)
    for name in rig:
        seen &= rig[name].sees(x, y, 0.0)
    return float(seen.mean())


def make_settings(experiment: Experiment, workflow: Workflow) -> Any:
    """Measurement settings: defaults, then those of the experiment, then those of the workflow.

    Parameters
    ----------
    experiment : Experiment
        The experiment.
    workflow : Workflow
        The workflow.

    Returns
    -------
    wavefield.measurement.Settings

    Raises
    ------
    ExperimentError
        If a name is unknown or a value does not fit.
    """
    from wavefield.measurement.settings import Settings, unknown_setting

    for source in (experiment, workflow):
        if unknown := unknown_setting(source.settings):
            location, sentence = unknown
            place = f"{place_of(source.path, ('settings', *location))}: " if source.path else ""
            raise ExperimentError(place + sentence)

    data: dict[str, Any] = {}
    if experiment.surface:
        data["pairs"] = experiment.surface.pairs
    if experiment.velocity:
        data["velocity_cameras"] = experiment.velocity.cameras
    for more in (experiment.settings, workflow.settings):
        for name, value in more.items():
            nested = isinstance(value, Mapping) and isinstance(data.get(name), Mapping)
            data[name] = {**data[name], **value} if nested else value
    return Settings.from_dict(data)


def choose_block(steps: int, workers: int, step_bytes: int, memory: int | None) -> int:
    """Steps per block: long enough that its three extra frames do not matter, short enough for memory.

    Parameters
    ----------
    steps : int
        Steps of the whole run.
    workers : int
        Workers that share it; each gets the same number of blocks.
    step_bytes : int
        Bytes of the results of one step.
    memory : int or None
        Bytes that a worker may use.

    Returns
    -------
    int

    Examples
    --------
    >>> choose_block(12000, 2, 151 * 201 * 45, None)
    100
    >>> choose_block(40, 2, 151 * 201 * 45, None)
    20
    """
    # results, their stack and their compressed copy are there at once; half the memory is for the measurement
    room = int((memory or 1_500_000_000) // 2 // (4 * step_bytes))
    longest = max(1, min(_LONGEST_BLOCK, room))
    rounds = -(-steps // (workers * longest))
    return max(1, min(longest, -(-steps // (workers * rounds))))


def process(
    prepared: Prepared, path: Path, map_unordered: MapFunction, progress: ProgressFunction | None = None
) -> Status:
    """Create the store or go on with it, until every block is done.

    Parameters
    ----------
    prepared : Prepared
        As from `prepare`.
    path : path
        The store.
    map_unordered : callable
        As from `wavefield.cubes.cluster.open_cluster`.
    progress : callable, optional
        Called with steps done, steps of the whole run, and a sentence.

    Returns
    -------
    Status

    Raises
    ------
    StoreError
        If the store was made with another recipe, or cannot be written, or blocks failed.
    RunStopped
        If it was interrupted.
    """
    path = path.absolute()
    with only_run(path), log_file(path), stop_signals(prepared.workflow.time_limit_seconds):
        try:
            _go_on(prepared, path, map_unordered, progress)
        except KeyboardInterrupt as stop:
            raise RunStopped(
                f"stopped{_why(stop)}{_how_far(path)}; nothing is lost, and the same command goes on"
            ) from None
    return status(path)


def _go_on(
    prepared: Prepared, path: Path, map_unordered: MapFunction, progress: ProgressFunction | None
) -> None:
    layout = _open_or_create(prepared, path)
    ranges = unfinished(path, layout, prepared.series)
    todo = [make_block(prepared.series, start, stop) for start, stop in ranges]
    tracker = _Tracker(layout.steps, layout.steps - sum(b.steps for b in todo), progress)
    tracker.say(f"{path.name}: recipe {prepared.recipe.hash}, {len(todo)} blocks to do")
    if todo:
        _work_off(prepared, path, todo, map_unordered, tracker)
    tracker.say("done")


def _how_far(path: Path) -> str:
    if not path.exists():
        return " before it began"
    now = status(path)
    return f" after {now.steps - now.left} of {now.steps} steps"


def _open_or_create(prepared: Prepared, path: Path) -> Layout:
    if path.exists():
        group = open_group(path)
        check_recipe(path, group, prepared.recipe)
        remove_leftovers(path)
        return read_layout(group)
    grid = prepared.grid
    first = next(iter(prepared.series.values())).first
    layout = Layout(prepared.steps, prepared.block, tuple(prepared.series), first)
    attributes: dict[str, Any] = {
        "experiment_file": str(prepared.experiment.path),
        "pixel_size": pixel_size(prepared.rig, grid),
    }
    if prepared.experiment.folder:
        attributes["image_folder"] = str(prepared.experiment.image_folder)
    attributes |= prepared.experiment.water.attributes()
    remove_leftovers(path)
    create_store(path, prepared.recipe, grid.x_nodes, grid.y_nodes, layout, attributes)
    create_preview(path, open_group(path))
    return layout


def unfinished(path: Path, layout: Layout, series: Mapping[str, FrameSeries]) -> list[tuple[int, int]]:
    """Blocks that are still to be measured: not done yet, or with bad frames that are good by now.

    Parameters
    ----------
    path : path
        The store.
    layout : Layout
        Its sizes.
    series : mapping of str to FrameSeries
        The frames.

    Returns
    -------
    list of (start, stop)
        Ranges of steps.
    """
    group = open_group(path)
    ledger = np.asarray(group["frame_status"][:])
    faults = np.asarray(group["frame_fault"][:])
    mended = np.zeros(layout.steps + 1, bool)
    for camera, index in np.argwhere(faults):
        if not series[layout.cameras[camera]].read(int(index)).fault:
            mended[index] = True
    again, todo = [], []
    for start, stop in layout.blocks():
        if (ledger[start:stop] == FrameStatus.NOT_STARTED).any():
            todo.append((start, stop))
        elif mended[max(start - 1, 0) : stop + 2].any():
            again.append(start)
            todo.append((start, stop))
    if again:
        log.info("frames that were bad can be read now: measuring %d blocks again", len(again))
        reset_blocks(path, again)
    return todo


def _work_off(
    prepared: Prepared,
    path: Path,
    todo: Sequence[Block],
    map_unordered: MapFunction,
    tracker: "_Tracker",
) -> None:
    work = Work(path, prepared.plan, prepared.experiment.frame_rate)
    failures: list[tuple[Block, BaseException]] = []
    succeeded = 0
    tracker.start()
    # closed here and now: what is not done yet is called off before anything else
    with closing(map_unordered(work, todo)) as results:
        for block, result in results:
            if isinstance(result, WavefieldError):
                raise result
            if isinstance(result, BaseException):
                log.error("steps %d to %d failed", block.start, block.stop - 1, exc_info=result)
                failures.append((block, result))
                if not succeeded and len(failures) >= _ENOUGH_FAILURES:
                    break
                continue
            succeeded += 1
            for message in result.messages:
                log.warning("%s", message)
            tracker.add(result.stop - result.start)
    if failures:
        block, error = failures[0]
        raise StoreError(
            f"{len(failures)} of {len(todo)} blocks failed, the first (steps {block.start} to "
            f"{block.stop - 1}) with {type(error).__name__}: {error}; see {log_path(path)}, and run the same "
            "command again to retry"
        ) from error


class _Tracker:
    """Counts steps, and tells the log and the user how far the run is."""

    def __init__(self, total: int, done: int, progress: ProgressFunction | None) -> None:
        self.total, self.done, self._progress = total, done, progress
        self._since, self._before = time.monotonic(), done
        self._logged = 0.0

    def start(self) -> None:
        self._since = time.monotonic()
        self.say("")

    def add(self, steps: int) -> None:
        self.done += steps
        now = time.monotonic()
        left = (now - self._since) / (self.done - self._before) * (self.total - self.done)
        sentence = f"{spell_time(left)} left" if self.done < self.total else ""
        if now - self._logged > 10 or self.done == self.total:
            self._logged = now
            log.info("%d of %d steps%s", self.done, self.total, f", {sentence}" if sentence else "")
        self._tell(sentence)

    def say(self, sentence: str) -> None:
        if sentence:
            log.info("%s", sentence)
        self._tell(sentence)

    def _tell(self, sentence: str) -> None:
        if self._progress:
            self._progress(self.done, self.total, sentence)


# -- the one place for signals, the one for the log, the one for the lock ------------------------------------


class _Stop(KeyboardInterrupt):
    """A signal other than Ctrl-C, or the time limit."""


def _why(stop: KeyboardInterrupt) -> str:
    return f" by {stop}" if isinstance(stop, _Stop) else ""


@contextmanager
def stop_signals(time_limit: float | None = None) -> Iterator[None]:
    """Let SIGTERM, SIGUSR1 (Slurm's warning) and a time limit stop a run as Ctrl-C does.

    Parameters
    ----------
    time_limit : float, optional
        Seconds.

    Yields
    ------
    None
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reasons = {
        name: reason
        for name, reason in (
            ("SIGTERM", "SIGTERM"),
            ("SIGUSR1", "SIGUSR1"),
            ("SIGALRM", "its time limit"),
        )
        if hasattr(signal, name)
    }

    def stop(number: int, frame: Any) -> None:
        raise _Stop(reasons[signal.Signals(number).name])

    before = {name: signal.signal(getattr(signal, name), stop) for name in reasons}
    if time_limit and hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, time_limit)
    try:
        yield
    finally:
        if time_limit and hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0)
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


def log_path(store: Path) -> Path:
    """The log of a store's runs.

    Parameters
    ----------
    store : path
        The store.

    Returns
    -------
    Path
    """
    return store.with_suffix(".log")


@contextmanager
def log_file(store: Path) -> Iterator[None]:
    """Write what a run says to a file beside its store.

    Parameters
    ----------
    store : path
        The store.

    Yields
    ------
    None
    """
    try:
        store.parent.mkdir(parents=True, exist_ok=True)
        handler = logging.FileHandler(log_path(store), delay=False)
    except OSError as error:
        raise write_error(store, error) from None
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    handler.handleError = lambda record: None  # type: ignore[method-assign]  # a full disk must not hide the cause
    level = log.level
    log.setLevel(logging.INFO)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
        with suppress(OSError):
            handler.close()


@contextmanager
def only_run(store: Path) -> Iterator[None]:
    """Refuse a second run on the same store while one is at work; a killed one leaves no lock behind.

    Parameters
    ----------
    store : path
        The store.

    Yields
    ------
    None

    Raises
    ------
    StoreError
        If another process is at work.
    """
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        yield
        return
    lock = store.with_name(f".{store.name}.lock")
    try:
        store.parent.mkdir(parents=True, exist_ok=True)
        stream = lock.open("a")
    except OSError as error:
        raise write_error(store, error) from None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(f"another run is writing {store}; wait for it, or stop it") from None
        except OSError:
            pass  # a file system without locks
        yield
    lock.unlink(missing_ok=True)
