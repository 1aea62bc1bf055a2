"""Time, memory and disk that a run will take, measured on a few of its steps."""

import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numcodecs
import numpy as np

from wavefield.errors import ExperimentError
from wavefield.execution.cluster import count_workers
from wavefield.execution.process import peak_memory
from wavefield.pipeline.chunk import Measured, make_chunk, measure_chunk
from wavefield.pipeline.learning import learn_from, samples
from wavefield.pipeline.prepare import PreparedRun
from wavefield.quality.record import complete_steps
from wavefield.series import Frame, FrameSeries
from wavefield.store.layout import COMPRESSION
from wavefield.text import spell_time
from wavefield.variables import AROUND, FrameStatus, Quality

MIN_FREE_SHARE = 1.1  # of what a run writes


@dataclass(frozen=True)
class Cost:
    """Time, memory and disk that a run will take, from measured steps."""

    step_seconds: float  # Time per step on one worker, s
    workers: int  # Workers that share the steps
    seconds: float  # Time of the whole run, s
    memory: int  # Memory per worker, bytes
    disk: int  # Size of the store, bytes
    free: int  # Room on the disk of the store, bytes

    def __str__(self) -> str:
        workers = "1 worker" if self.workers == 1 else f"{self.workers} workers"
        text = (
            f"{spell_time(self.seconds)} on {workers} ({self.step_seconds:.2f} s per step), "
            f"{self.memory / 1e9:.2f} GB of memory per worker, {spell_size(self.disk)} of disk"
        )
        if self.free < MIN_FREE_SHARE * self.disk:
            text += f" - but only {spell_size(self.free)} are free: free some room or write elsewhere with -o"
        return text


def measure_cost(prepared: PreparedRun) -> tuple[Cost, Mapping[str, np.ndarray]]:
    """Measure a few steps in the middle of the run, and extrapolate to all of it; also their fields."""
    start = whole_step(prepared.series)
    stop = min(start + 3, prepared.steps)
    learned = learn_from(samples(prepared.series, [start]), prepared.geometry, prepared.experiment.frame_rate)
    prepared = prepared.with_prior(learned)  # as a run learns; and compiles
    one, step = _measured(prepared, start, stop)
    if (one.frame_status == FrameStatus.FAILED).all() and not one.fields["quality"].any():
        raise ExperimentError(
            f"the step of frame {prepared.first_frame + start} could not be measured; check its images, the "
            "rig and the grid"
        )
    workers = count_workers(prepared.workflow)
    frames_measured = prepared.steps * (1 + 5 / prepared.chunk_steps)
    cost = Cost(
        step_seconds=step,
        workers=workers,
        seconds=step * frames_measured / workers,
        memory=peak_memory() + 3 * prepared.chunk_steps * prepared.step_bytes,
        disk=int(_stored_bytes(one.fields) * prepared.steps / (stop - start)),
        free=shutil.disk_usage(prepared.experiment.path.parent).free,
    )
    return cost, one.fields


@dataclass(frozen=True)
class _Clocked(FrameSeries):
    """Frames of one camera, with the times at which each was requested."""

    requested: list[float] = field(default_factory=list)

    def read(self, index: int) -> Frame:
        self.requested.append(time.perf_counter())
        return super().read(index)


def _measured(prepared: PreparedRun, start: int, stop: int) -> tuple[Measured, float]:
    """Measure a chunk, and the seconds per step after the first frames were read."""
    series = {name: _Clocked(**vars(one)) for name, one in prepared.series.items()}
    chunk = make_chunk(series, start, stop, prepared.departures)
    since = time.perf_counter()
    measured = measure_chunk(chunk, prepared.geometry, prepared.experiment.frame_rate, prepared.model)
    whole = time.perf_counter() - since
    frames = chunk.steps + 2 * AROUND + 1
    gaps = np.diff(next(iter(series.values())).requested[-frames:])
    # each frame is requested when all is done with those before: the first have no step to give yet
    whole_steps = gaps[2 * AROUND + 1 :]
    return measured, float(whole_steps.mean()) if whole_steps.size else whole / frames


def _stored_bytes(fields: Mapping[str, np.ndarray]) -> int:
    """Bytes of measured fields after compression as in the store."""
    codec = numcodecs.Blosc(**COMPRESSION, shuffle=numcodecs.Blosc.SHUFFLE)
    return sum(len(codec.encode(np.ascontiguousarray(values))) for values in fields.values())


def spell_size(count: float) -> str:
    """Bytes in words."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def whole_step(series: Mapping[str, FrameSeries]) -> int:
    """A step near the middle whose frames are there in all cameras."""
    complete = complete_steps(series)
    steps = np.flatnonzero(complete)
    if steps.size == 0:
        raise ExperimentError("no two consecutive frames are there in all cameras: nothing can be measured")
    return int(steps[np.argmin(np.abs(steps - len(complete) // 2))])
