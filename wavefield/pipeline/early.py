"""Early steps of a run: every so-many-th step of the record first, so that `wavefield look` shows all of it.

Each is measured from its own two frames alone, with the run's geometry and what it learned; the six frames
of a step of the cube would take three times as long. Values do not depend on workers; every how many steps
one is measured depends on the speed of this machine, and is kept in the preview.
"""

import logging
import math
import time
from collections.abc import Sequence
from pathlib import Path

from wavefield.execution.cluster import count_workers
from wavefield.execution.worker_settings import one_thread
from wavefield.pipeline.chunk import EarlyStep, early_step, measure_chunk
from wavefield.pipeline.prepare import PreparedRun
from wavefield.store.early_preview import create_early, early_every, early_steps
from wavefield.store.preview import create_preview, open_preview
from wavefield.store.read import open_group

log = logging.getLogger("wavefield.run")

SECONDS = 55.0  # from the beginning of a run to the last early step: a minute with the imports before
_LEAST_SECONDS = 15.0  # of measuring early steps, however long it took to prepare
_START_SECONDS = 4.0  # until workers are ready
MOST = 500  # early steps: more are not needed to find one's way in a record


def plan_early(
    prepared: PreparedRun, path: Path, todo: Sequence[tuple[int, int]], until: float
) -> list[EarlyStep]:
    """Early steps in the chunks (start, stop) that are still to be measured, in the order of `bisecting`.
    There are as many as are done by a time of the monotonic clock, unless an earlier run has chosen.
    """
    group = open_group(path)
    preview = open_preview(path, group, "r+")
    if preview is None:
        create_preview(path, group)
        preview = open_preview(path, group, "r+")
        assert preview is not None
    every = early_every(preview)
    if not every:
        every = _choose_every(prepared, sum(stop - start for start, stop in todo), until)
        if every < 2:
            log.info("no preview: the run itself takes no longer")
            return []
        create_early(path, preview, group, every)
    there = set(early_steps(path, preview))
    steps = range(0, prepared.steps, every)
    left = {k for start, stop in todo for k in range(start, stop)} - there
    log.info("preview: one step in %d, %d of them to measure", every, sum(k in left for k in steps))
    chosen = [steps[k] for k in bisecting(len(steps)) if steps[k] in left]
    return [early_step(prepared.series, k, prepared.departures) for k in chosen]


def bisecting(count: int) -> list[int]:
    """Numbers below a count, every beginning of the list spread over all of them: 0, 4, 2, 6, 1, 5, 3, 7."""
    digits = max(count - 1, 1).bit_length()
    return sorted(range(count), key=lambda k: int(f"{k:0{digits}b}"[::-1], 2))


def _choose_every(prepared: PreparedRun, left: int, until: float) -> int:
    """Every how many steps can be measured in the time that is left, by the time that one takes here."""
    middle = prepared.steps // 2
    with one_thread():
        for step in (middle, min(middle + 1, prepared.steps - 1)):  # the first one also compiles
            since = time.perf_counter()
            early = early_step(prepared.series, step, prepared.departures)
            measure_chunk(early, prepared.geometry, prepared.experiment.frame_rate, prepared.model)
            seconds = time.perf_counter() - since
    time_left = max(until - _START_SECONDS - time.monotonic(), _LEAST_SECONDS)
    room = min(MOST, max(1, int(count_workers(prepared.workflow) * time_left / seconds)))
    return math.ceil(left / room)
