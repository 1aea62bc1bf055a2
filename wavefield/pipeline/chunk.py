"""Measure one chunk and write it into the store.

A step is the interval between two consecutive frames; the cube has one value per node and step. A chunk is a
range of n steps that one task measures. It reads n + 5 frames: the n + 1 frames of its steps and two more on
either side for z at mid-step. One frame before these is read as well, to find out whether the first repeats
it. Chunks are independent: they can be measured in any order, by any process, and again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from wavefield.series import Frame
from wavefield.store.write_cube import write_chunk
from wavefield.variables import AROUND, FrameFault, FrameStatus

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, Model


class Source(Protocol):
    """Frames of one camera: a `FrameSeries`, or images in an array. An index counts from 0."""

    def __len__(self) -> int: ...

    def read(self, index: int) -> Frame:
        """Read the frame of an index: its image, or the fault for which there is none."""
        ...

    def covered(self, index: int) -> np.ndarray | None:
        """Return the mask of a frame (row, column), True where masked; None if there is none."""
        ...

    def place(self, index: int) -> str:
        """Return the name of a frame, for messages."""
        ...

    def window(self, start: int, stop: int) -> "Source":
        """Return the frames from start to stop (excluded), as a source."""
        ...


@dataclass(frozen=True)
class Chunk:
    """A range of steps that one task measures, with the frames that it needs."""

    start: int  # First step
    stop: int  # Step after the last
    # By camera: the frames from start - 3 to stop + 2 that exist
    sources: Mapping[str, Source] = field(repr=False)
    first: int  # Index in the record of the first frame of the sources
    # (n + 5,): lateness of its frames relative to even times, in frame intervals; None if times are even
    departures: np.ndarray | None = field(default=None, repr=False)

    @property
    def steps(self) -> int:
        """Number of steps."""
        return self.stop - self.start


@dataclass(frozen=True)
class Measured:
    """Results of `measure_chunk` for a chunk of n steps."""

    fields: dict[str, np.ndarray]  # (n, ny, nx): The variables of `wavefield.variables.CUBE_FIELDS`
    frame_status: np.ndarray  # (n,): See `wavefield.variables.FrameStatus`
    faults: dict[str, dict[int, FrameFault]]  # Bad frames of each camera, by index in the record
    messages: list[str]  # A sentence about each bad frame


def make_chunk(
    sources: Mapping[str, Source], start: int, stop: int, departures: np.ndarray | None = None
) -> Chunk:
    """Return the chunk of the steps from start to stop (excluded), with the frames that it needs.
    ``sources`` and ``departures`` (frames,) are those of the whole record. A departure is the lateness of a
    frame relative to even times, in frame intervals."""
    first = max(start - AROUND - 1, 0)
    windows = {name: s.window(first, stop + 1 + AROUND) for name, s in sources.items()}
    if departures is not None:
        departures = np.pad(departures, AROUND)[start : stop + 1 + 2 * AROUND]
    return Chunk(start, stop, windows, first, departures)


def read_frame(source: Source, index: int, before: np.ndarray | None = None) -> Frame:
    """Read a frame, and mark it as repeated if it equals the image of the frame before it.
    ``before`` is that image; it is read from the source if it is not given."""
    frame = source.read(index)
    if frame.image is not None and index:
        before = source.read(index - 1).image if before is None else before
        if before is not None and np.array_equal(frame.image, before):
            words = "is identical to the frame before it, and counts as missing"
            return Frame(frame.image, FrameFault.REPEATED, f"{source.place(index)} {words}")
    return frame


class ChunkFrames(Sequence[np.ndarray | None]):
    """The images of one camera in a chunk of n steps: n + 5 frames, or None for a bad or missing one.

    They are read on demand, and only the last few stay in memory. ``faults`` and ``messages`` describe the
    bad frames that were read, by index in the record.
    """

    _KEEP = 2 * AROUND + 2  # frames that one step uses

    def __init__(self, source: Source, chunk: Chunk) -> None:
        self._source, self._chunk = source, chunk
        self._kept: dict[int, np.ndarray | None] = {}
        self._latest: tuple[int, np.ndarray | None] = (-2, None)  # index in the source and image, last read
        self.faults: dict[int, FrameFault] = {}
        self.messages: dict[int, str] = {}

    def __len__(self) -> int:
        return self._chunk.steps + 2 * AROUND + 1

    def __getitem__(self, position: Any) -> Any:
        if not 0 <= position < len(self):
            raise IndexError(position)
        if position not in self._kept:
            self._kept[position] = self._read(position)
            while len(self._kept) > self._KEEP:
                del self._kept[next(iter(self._kept))]
        return self._kept[position]

    def _read(self, position: int) -> np.ndarray | None:
        index = self._chunk.start - AROUND + position
        inside = index - self._chunk.first
        if not 0 <= inside < len(self._source):
            return None  # outside the record: not a fault
        frame = read_frame(self._source, inside, self._latest[1] if self._latest[0] == inside - 1 else None)
        self._latest = inside, frame.image
        if not frame.fault:
            return frame.image
        self.faults[index], self.messages[index] = frame.fault, frame.message
        return None


class ChunkMasks(Sequence[np.ndarray | None]):
    """The masks of one camera in a chunk of n steps, for n + 5 frames; None for a frame without one."""

    def __init__(self, source: Source, chunk: Chunk) -> None:
        self._source, self._chunk = source, chunk

    def __len__(self) -> int:
        return self._chunk.steps + 2 * AROUND + 1

    def __getitem__(self, position: Any) -> Any:
        inside = self._chunk.start - AROUND + position - self._chunk.first
        return self._source.covered(inside) if 0 <= inside < len(self._source) else None


def measure_chunk(
    chunk: Chunk,
    geometry: "GridGeometry",
    frame_rate: float,
    model: "Model | None" = None,
    terms: bool = False,
) -> Measured:
    """Measure all steps of a chunk.
    ``geometry`` and ``model`` hold the rig, grid and settings, and what was learned from the record. With
    ``terms``, the terms of the standard uncertainties are added to the fields."""
    from wavefield.measurement.step import measure

    frames = {name: ChunkFrames(source, chunk) for name, source in chunk.sources.items()}
    masks = {name: ChunkMasks(source, chunk) for name, source in chunk.sources.items()}
    fields = dict(measure(frames, geometry, frame_rate, model, masks, chunk.departures, terms))
    status = np.asarray(fields.pop("frame_status"), np.uint8)
    _find_dim_frames(frames, status, chunk, geometry)
    _find_high_water(frames, fields["z"], status, chunk, geometry)
    faults = {name: dict(lazy.faults) for name, lazy in frames.items()}
    messages = [lazy.messages[i] for lazy in frames.values() for i in sorted(lazy.messages)]
    return Measured(fields, status, faults, messages)


def _find_dim_frames(
    frames: Mapping[str, ChunkFrames], status: np.ndarray, chunk: Chunk, geometry: "GridGeometry"
) -> None:
    """Add nearly blank images to the faults of ``frames``.
    Only the two frames of each step that was not fully measured are examined."""
    from wavefield.measurement.images import usable

    suspicious = np.flatnonzero(status != FrameStatus.DONE)
    for position in sorted({int(step) + k for step in suspicious for k in (AROUND, AROUND + 1)}):
        index = chunk.start - AROUND + position
        for name, lazy in frames.items():
            if index not in lazy.faults:
                image = lazy[position]
                if image is not None and not usable(image, geometry.rig[name].size):
                    lazy.faults[index] = FrameFault.BLANK
                    lazy.messages[index] = f"{name} frame at index {index} is nearly blank"


def _find_high_water(
    frames: Mapping[str, ChunkFrames],
    z: np.ndarray,
    status: np.ndarray,
    chunk: Chunk,
    geometry: "GridGeometry",
) -> None:
    """Mark steps in which the elevation z (n, ny, nx) reaches a limit of the searched range.
    Adds the fault to the first frame of the step in the reference camera, and changes ``status`` of the
    step."""
    from wavefield.measurement.search_range import at_border

    for step in np.flatnonzero(status != FrameStatus.FAILED).tolist():
        if at_border(z[step], geometry.z_range):
            index, reference = chunk.start + step, frames[geometry.reference]
            sentence = "the water reaches a limit of the elevations searched (`z_range`)"
            reference.faults.setdefault(index, FrameFault.RANGE)
            reference.messages.setdefault(index, f"{geometry.reference} frame at index {index}: {sentence}")
            status[step] = FrameStatus.DONE_WITH_FAULTS


@dataclass(frozen=True)
class Report:
    """Summary of a chunk that was measured and written; a worker returns it."""

    start: int  # First step
    stop: int  # Step after the last
    failed: int  # Steps that could not be measured
    messages: tuple[str, ...]  # A sentence about each bad frame


@dataclass(frozen=True)
class Work:
    """Task of a worker: measure a chunk and write it to the store."""

    store: Path  # Store of the cube
    geometry: "GridGeometry"  # Pickled as rig, grid and settings, and computed once per process
    model: "Model | None"  # Bead widths, spectra and noise learned from the record
    frame_rate: float  # Hz

    def __call__(self, chunk: Chunk) -> Report:
        """Measure a chunk, write it to the store, and return a summary."""
        measured = measure_chunk(chunk, self.geometry, self.frame_rate, self.model)
        write_chunk(self.store, chunk.start, measured.fields, measured.frame_status, measured.faults)
        failed = int(np.count_nonzero(measured.frame_status == FrameStatus.FAILED))
        return Report(chunk.start, chunk.stop, failed, tuple(measured.messages))
