"""Process an experiment into a store, chunk by chunk, in one process or many.

A step is the interval between two consecutive frames; a chunk is a range of steps that one task measures and
writes. After an interruption (Ctrl-C, time limit, failed scheduler, full disk) the same command resumes. It
measures only chunks that are not done, as the status of each step in the store shows.
"""

import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

import numpy as np

from wavefield.errors import RunStopped, StoreError, WavefieldError
from wavefield.execution.cluster import MapUnordered, open_cluster, threads_here
from wavefield.execution.process import deferred_signals, stop_signals, stopped_by
from wavefield.execution.run_files import jobs_folder, locked, log_file, log_path
from wavefield.execution.workflow import Workflow
from wavefield.pipeline.chunk import Chunk, make_chunk, measure_and_write, read_frame
from wavefield.pipeline.learning import learn_record, once_per_cube
from wavefield.pipeline.opened_run import check_images, fingerprints, labels
from wavefield.pipeline.prepare import PreparedRun, load_files, prepare, refuse_small_fields
from wavefield.rig import Rig
from wavefield.rig.field import pixel_size
from wavefield.series import Experiment, FrameSeries
from wavefield.store import beside
from wavefield.store.layout import FINISHED, StoreLayout, create_store, update_metadata
from wavefield.store.ledger import Status, status
from wavefield.store.preview import create_preview
from wavefield.store.read import open_group, read_layout
from wavefield.store.recipe import check_recipe
from wavefield.store.verdict import check_verdict
from wavefield.store.verify import missing_chunks
from wavefield.store.write_cube import relabel, remove_partial_files, reset_chunks
from wavefield.text import spell_time
from wavefield.variables import AROUND, FrameFault, FrameStatus

log = logging.getLogger("wavefield.run")
ProgressFunction = Callable[[int, int, str], None]

MEASURING = ("wavefield.measurement.step", "wavefield.pipeline.chunk")  # modules that workers import at start
ASSESSING = "assessing the cube"  # message of the last stage of a run
_ENOUGH_FAILURES = 3  # a run stops if so many chunks fail before any succeeds: all would fail


def run(
    experiment: str | Path | Experiment,
    out: str | Path | None = None,
    *,
    rig: str | Path | Rig | None = None,
    workflow: str | Path | Workflow | None = None,
    progress: ProgressFunction | None = None,
) -> Status:
    """Process an experiment into a cube, or resume an earlier run with the same inputs.

    Parameters
    ----------
    experiment : path or Experiment
        Experiment file, or the experiment. `wavefield.pipeline.catalog.run_catalog` processes catalogs.
    out : path, optional
        Store of the cube; by default ``cube.zarr`` next to the experiment file.
    rig : path or Rig, optional
        Used instead of the rig that the experiment names.
    workflow : path or Workflow, optional
        Workers, and settings that replace those of the experiment; by default the processes of this machine.
    progress : callable, optional
        Called with the number of steps done, the number of all steps, and a sentence on the stage of the run.

    Returns
    -------
    Status
        Numbers of steps done, failed and left, and remarks on faults of the measurement (the verdict).

    Raises
    ------
    ExperimentError, RigError
        If a file is missing or wrong; no cube has been written then.
    StoreError
        If the store was made from other inputs or images, cannot be written, or is being written by another
        run; or if steps could not be computed because of an unexpected error.
    RunStopped
        If Ctrl-C, a signal or the workflow's time limit has stopped the run. The same call resumes it.

    Notes
    -----
    The results do not depend on the number of workers or on the size of chunks.

    A store keeps its recipe, the record of all inputs: settings, rig, grid, names of images, and version of
    the algorithm. A run resumes only if these are the same. Name and description of the experiment, and depth
    and surface tension of the water, may change.

    Worker processes import the program that started them: in a script, call this below
    ``if __name__ == "__main__":``.

    Examples
    --------
    Two steps of a small simulated tank, in this process.

    >>> import tempfile
    >>> from wavefield.tank import Scene, simulate
    >>> scene = Scene.load("demo").with_(rig={"crop": 0.15}, frames=3, sea={"shortest": 0.15})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found = run(simulate(scene, folder), rig=scene.build_rig(), workflow=Workflow(cluster="none"))
    >>> found.complete, found.steps
    (True, 2)
    """
    experiment, workflow = load_files(experiment, workflow)
    path = Path(out if out is not None else experiment.resolve("cube.zarr")).absolute()
    with ExitStack() as stack:
        stack.enter_context(locked(path))
        if path.exists():
            open_group(path)  # refuses a folder that is not a cube
        check_verdict(path)
        with deferred_signals():  # Ctrl-C during an import may be lost
            map_unordered = stack.enter_context(open_cluster(workflow, jobs_folder(path), MEASURING))
            prepared = prepare(experiment, rig, workflow)
        return process(prepared, path, map_unordered, progress)


def process(
    prepared: PreparedRun, path: Path, map_unordered: MapUnordered, progress: ProgressFunction | None = None
) -> Status:
    """Create the store ``path`` or resume it, measure all chunks of steps that are left, and assess the cube.
    The caller must have locked the store. ``map_unordered(work, chunks)`` runs ``work`` on workers, and
    yields each chunk with its result or exception. RunStopped if the run is interrupted."""
    refuse_small_fields(prepared.geometry, prepared.experiment.path)
    with log_file(path), stop_signals(prepared.workflow.time_limit_seconds):
        try:
            prepared, layout = _open_or_create(prepared, path)
            ranges = unfinished(path, layout, prepared.series)
            if ranges:
                update_metadata(path, {FINISHED: None})
            todo = [make_chunk(prepared.series, start, stop, prepared.departures) for start, stop in ranges]
            tracker = _Tracker(layout.steps, layout.steps - sum(chunk.steps for chunk in todo), progress)
            tracker.report(f"{path.name}: recipe {prepared.recipe.hash}, {len(todo)} chunks to measure")
            if todo:
                _work_off(prepared, path, todo, map_unordered, tracker)
                tracker.report(ASSESSING)
            tracker.report("done")
        except KeyboardInterrupt as stop:
            now = status(path) if path.exists() else None
            done = f" after {now.steps - now.left} of {now.steps} steps" if now else " before it began"
            raise RunStopped(
                f"{stopped_by(stop)}{done}; nothing is lost, and the same command resumes"
            ) from None
    with deferred_signals():  # slow imports, which only the end of a run needs
        from wavefield.pipeline.assess import assess_run, clear_discontinuous_steps, store_pair_statistics
    found = status(path)
    clear_discontinuous_steps(prepared, found)
    if found.complete:
        store_pair_statistics(prepared, path)
    assess_run(prepared, found).save(path)
    if found.complete:
        if not open_group(path).attrs.get(FINISHED):
            update_metadata(path, {FINISHED: True})
        if prepared.experiment.smooth and (todo or not beside(path, "smooth", ".zarr").exists()):
            from wavefield.pipeline.analysis import write_smoothed

            log.info("wrote %s", write_smoothed(path))
    return status(path)


def _open_or_create(prepared: PreparedRun, path: Path) -> tuple[PreparedRun, StoreLayout]:
    """Open the store ``path`` of a run or, if it does not exist, learn from sample frames and create it.
    Returns the run with what was learned (from the store, if it exists), and the layout of the store.
    StoreError if the store was made from other inputs or images."""
    if path.exists():
        group = open_group(path)
        check_recipe(path, group.attrs, prepared.recipe)
        check_images(str(path), json.loads(group.attrs.get("fingerprints", "{}")), prepared.series)
        remove_partial_files(path)
        prepared = prepared.with_prior(json.loads(str(group.attrs["recipe"]))["record"])
        for change in relabel(path, prepared.experiment.name, labels(prepared.experiment, path)):
            log.info("label changed, nothing is measured again: %s", change)
        return prepared, read_layout(open_group(path))
    log.info("learning bead widths, spectra and noise from sample frames")
    source, threads = prepared.series, threads_here(prepared.workflow)
    learned = learn_record(source, prepared.steps, prepared.geometry, prepared.frame_rate, threads)
    prepared = prepared.with_prior(learned)
    grid, cameras = prepared.grid, tuple(prepared.series)
    layout = StoreLayout(prepared.steps, prepared.chunk_steps, cameras, prepared.first_frame)
    attributes = {
        "pixel_size": pixel_size(prepared.rig, grid),
        "fingerprints": json.dumps(fingerprints(prepared.series)),
        **labels(prepared.experiment, path),
    }
    once = once_per_cube(prepared.geometry, prepared.record)
    create_store(path, prepared.recipe, grid.x_nodes, grid.y_nodes, layout, attributes, once)
    create_preview(open_group(path))
    return prepared, layout


def unfinished(path: Path, layout: StoreLayout, series: Mapping[str, FrameSeries]) -> list[tuple[int, int]]:
    """Return the chunks of steps still to measure, each as (first step, last step + 1). Chunks whose files
    are missing, or which had bad frames that can be read now, are first marked as not started."""
    from wavefield.measurement.images import usable

    missing = missing_chunks(path, layout)
    if missing:
        log.warning("files of %d chunks are missing; they are measured again", len(missing))
    faults = np.asarray(open_group(path)["frame_fault"][:])
    repaired = np.zeros(layout.steps + 1, bool)
    for camera, index in np.argwhere((faults != 0) & (faults != FrameFault.RANGE)):
        one = series[layout.cameras[camera]]
        frame = read_frame(one, int(index))
        repaired[index] |= not frame.fault and usable(frame.image, one.shape[::-1])
    chunks = list(layout.chunks())
    again = [a for a, b in chunks if repaired[max(a - AROUND, 0) : b + 1 + AROUND].any()]
    if again:
        log.info("frames that were bad are readable now; %d chunks are measured again", len(again))
    if missing or again:
        reset_chunks(path, sorted({*missing, *again}))
    ledger = np.asarray(open_group(path)["frame_status"][:])
    return [(a, b) for a, b in chunks if (ledger[a:b] == FrameStatus.NOT_STARTED).any()]


def _work_off(
    prepared: PreparedRun, path: Path, todo: Sequence[Chunk], map_unordered: MapUnordered, tracker: "_Tracker"
) -> None:
    """Measure the chunks ``todo`` on workers, and count their steps in ``tracker``.
    A WavefieldError of a chunk is raised at once. Other errors are raised as StoreError after all chunks, or
    once three chunks have failed and none has succeeded."""
    work = partial(measure_and_write, path, prepared.geometry, prepared.model, prepared.frame_rate)
    failures: list[tuple[Chunk, BaseException]] = []
    succeeded = 0
    # on an error, closing cancels the tasks that are left before anything else happens
    with closing(map_unordered(work, todo)) as results:
        for chunk, result in results:
            if isinstance(result, WavefieldError):
                raise result
            if isinstance(result, BaseException):
                log.error("steps %d to %d failed", chunk.start, chunk.stop - 1, exc_info=result)
                failures.append((chunk, result))
                if not succeeded and len(failures) >= _ENOUGH_FAILURES:
                    break
                continue
            succeeded += 1
            for message in result:
                log.warning("%s", message)
            tracker.add(chunk.steps)
    if failures:
        chunk, error = failures[0]
        raise StoreError(
            f"{len(failures)} of {len(todo)} chunks failed, the first (steps {chunk.start} to "
            f"{chunk.stop - 1}) with {type(error).__name__}: {error}; see {log_path(path)}, and run the same "
            "command again to retry"
        ) from error


class _Tracker:
    """Counts the measured steps of a run, and reports progress to the log and to the user's function.
    ``total`` is the number of all steps; ``done`` steps were measured before this run."""

    def __init__(self, total: int, done: int, progress: ProgressFunction | None) -> None:
        self.total, self.done, self._progress = total, done, progress or (lambda *_: None)
        self._since, self._before, self._logged = time.monotonic(), done, 0.0

    def add(self, steps: int) -> None:
        """Add ``steps`` newly measured steps, and report the number of steps and the time left."""
        self.done += steps
        now = time.monotonic()
        left = (now - self._since) / (self.done - self._before) * (self.total - self.done)
        sentence = f"{spell_time(left)} left" if self.done < self.total else ""
        if now - self._logged > 10 or self.done == self.total:
            self._logged = now
            log.info("%d of %d steps%s", self.done, self.total, f", {sentence}" if sentence else "")
        self._progress(self.done, self.total, sentence)

    def report(self, sentence: str) -> None:
        """Report a stage of the run, such as "assessing the cube"."""
        log.info("%s", sentence)
        self._progress(self.done, self.total, sentence)
