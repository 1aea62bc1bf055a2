"""What a worker does: measure one chunk and write it. Imports little, so that workers start quickly."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wavefield.errors import StoreError
from wavefield.file_access import accessing
from wavefield.pipeline.chunk import Chunk, measure_chunk
from wavefield.store.write_cube import write_chunk
from wavefield.variables import FrameStatus

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry, Model


@dataclass(frozen=True)
class Report:
    """What a worker reports of a chunk that it has written."""

    start: int  # Range of steps
    stop: int
    failed: int  # Steps that could not be measured
    messages: tuple[str, ...]  # A sentence about each bad frame


@dataclass(frozen=True)
class Work:
    """Measures one chunk and writes it: what a worker is sent."""

    store: Path  # Where to write
    geometry: "GridGeometry"  # Pickles as rig, grid and settings; computed once per process
    model: "Model | None"  # What was learned of the record
    frame_rate: float  # Hz

    def __call__(self, chunk: Chunk) -> Report:
        """Measure and write."""
        measured = measure_chunk(chunk, self.geometry, self.frame_rate, self.model)
        with accessing(self.store, StoreError, "writing"):
            write_chunk(
                self.store,
                chunk.start,
                measured.fields,
                measured.frame_status,
                measured.faults,
                measured.shifts,
            )
        failed = int(np.count_nonzero(measured.frame_status == FrameStatus.FAILED))
        return Report(chunk.start, chunk.stop, failed, tuple(measured.messages))
