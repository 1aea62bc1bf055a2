"""Measure one chunk and write it into the store.

A step is the interval between two consecutive frames. A chunk is a range of n steps that one task measures.
The task reads n + 5 frames: the n + 1 frames of the steps, and two more on either side for z at mid-step. It
also reads one frame before these, to find out whether the next frame repeats it. Chunks are independent: they
can be measured in any order, by any process, and again.
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
    """Interface of the frames of one camera: a `FrameSeries`, or images in an array. Indices begin at 0."""

    def __len__(self) -> int: ...

    def read(self, index: int) -> Frame:
        """Return a frame, with its image or, if the image is missing or bad, with a fault instead."""

    def covered(self, index: int) -> np.ndarray | None:
        """Return the mask of a frame, (row, column), True where masked; None if the frame has no mask."""

    def place(self, index: int) -> str:
        """Return the name of a frame for messages, such as its camera and number."""

    def window(self, start: int, stop: int) -> "Source":
        """Return the frames start to stop - 1, as far as they exist, as another source."""


@dataclass(frozen=True)
class Chunk:
    """A range of steps that one task measures, with the frames that the task needs."""

    start: int  # Index of the first step in the record
    stop: int  # Index of the last step plus 1
    sources: Mapping[str, Source] = field(repr=False)  # Frames start - 3 to stop + 2 that exist, by camera
    first: int  # Index in the record of the first frame of the sources
    # (n + 5,): delay of its frames relative to even times, in frame intervals; None if times are even
    departures: np.ndarray | None = field(default=None, repr=False)

    @property
    def steps(self) -> int:
        """Number of steps in the chunk."""
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
    """Return the chunk of the steps start to stop - 1; ``sources`` holds all frames of the record by camera.
    ``departures`` (frame,) are delays of these frames relative to even times, in frame intervals."""
    first = max(start - AROUND - 1, 0)
    windows = {name: s.window(first, stop + 1 + AROUND) for name, s in sources.items()}
    if departures is not None:
        departures = np.pad(departures, AROUND)[start : stop + 1 + 2 * AROUND]
    return Chunk(start, stop, windows, first, departures)


def read_frame(source: Source, index: int, before: np.ndarray | None = None) -> Frame:
    """Read a frame, and give it a fault if its image is identical to the image of the frame before it.
    ``before`` is that earlier image; if it is None, the earlier frame is read, too."""
    frame = source.read(index)
    if frame.image is not None and index:
        before = source.read(index - 1).image if before is None else before
        if before is not None and np.array_equal(frame.image, before):
            words = "is identical to the frame before it, and counts as missing"
            return Frame(frame.image, FrameFault.REPEATED, f"{source.place(index)} {words}")
    return frame


class ChunkFrames(Sequence[np.ndarray | None]):
    """The n + 5 images of one camera for a chunk of n steps, read on demand; None for bad or absent frames.
    ``bad`` holds the fault and a message of each bad frame read so far, by its index in the record."""

    _KEEP = 2 * AROUND + 2  # frames that one step uses

    def __init__(self, source: Source, chunk: Chunk, size: tuple[int, int]) -> None:
        self._source, self._chunk, self._size = source, chunk, size
        self._kept: dict[int, np.ndarray | None] = {}
        self._latest: tuple[int, np.ndarray | None] = (-2, None)  # index in the source and image, last read
        self.bad: dict[int, tuple[FrameFault, str]] = {}

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
        from wavefield.measurement.images import usable

        index = self._chunk.start - AROUND + position
        inside = index - self._chunk.first
        if not 0 <= inside < len(self._source):
            return None  # outside the record: not a fault
        frame = read_frame(self._source, inside, self._latest[1] if self._latest[0] == inside - 1 else None)
        self._latest = inside, frame.image
        if not frame.fault and not usable(frame.image, self._size):
            frame = Frame(None, FrameFault.BLANK, f"{self._source.place(inside)} is nearly blank")
        if not frame.fault:
            return frame.image
        self.bad[index] = frame.fault, frame.message
        return None


class ChunkMasks(Sequence[np.ndarray | None]):
    """The masks of one camera for the n + 5 frames of a chunk of n steps; None for a frame without a mask."""

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
    """Measure elevation and velocity at all steps, from frame to frame, of a chunk; ``frame_rate`` is in Hz.
    ``model`` is the estimator, trained on sample frames; None if that failed. With ``terms``, the
    fields of the result include ``uncertainty_terms``, the terms of the standard uncertainties."""
    from wavefield.measurement.step import measure

    sizes = {name: geometry.rig[name].size for name in chunk.sources}
    frames = {name: ChunkFrames(source, chunk, sizes[name]) for name, source in chunk.sources.items()}
    masks = {name: ChunkMasks(source, chunk) for name, source in chunk.sources.items()}
    fields = dict(measure(frames, geometry, frame_rate, model, masks, chunk.departures, terms))
    status = np.asarray(fields.pop("frame_status"), np.uint8)
    _find_high_water(frames, fields["z"], status, chunk, geometry)
    faults = {name: {i: fault for i, (fault, _) in lazy.bad.items()} for name, lazy in frames.items()}
    messages = [lazy.bad[i][1] for lazy in frames.values() for i in sorted(lazy.bad)]
    return Measured(fields, status, faults, messages)


def _find_high_water(
    frames: Mapping[str, ChunkFrames],
    z: np.ndarray,
    status: np.ndarray,
    chunk: Chunk,
    geometry: "GridGeometry",
) -> None:
    """Mark the steps whose elevation z (n, ny, nx), m, reaches a limit of the searched range.
    Changes two arguments: ``status`` (n,) of such a step becomes "done with faults", and in ``frames`` the
    first frame of the step becomes a bad frame of the reference camera."""
    from wavefield.measurement.search_range import at_border

    for step in np.flatnonzero(status != FrameStatus.FAILED).tolist():
        if at_border(z[step], geometry.z_range):
            index, name = chunk.start + step, geometry.reference
            sentence = "the water reaches a limit of the elevations searched (`z_range`)"
            message = f"{name} frame at index {index}: {sentence}"
            frames[name].bad.setdefault(index, (FrameFault.RANGE, message))
            status[step] = FrameStatus.DONE_WITH_FAULTS


def measure_and_write(
    store: Path, geometry: "GridGeometry", model: "Model | None", frame_rate: float, chunk: Chunk
) -> list[str]:
    """Measure a chunk, write it to the store, and return a sentence about each bad frame.
    ``frame_rate`` is in Hz; ``model`` is the estimator, trained on sample frames (None if this failed)."""
    measured = measure_chunk(chunk, geometry, frame_rate, model)
    write_chunk(store, chunk.start, measured.fields, measured.frame_status, measured.faults)
    return measured.messages
