"""What a worker does: measure one block and write it. Imports little, so that workers start quickly."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wavefield.cubes.block import Block, measure_block
from wavefield.store.write import write_block
from wavefield.variables import FrameStatus


@dataclass(frozen=True)
class Report:
    """What a worker says of a block that it has written.

    Parameters
    ----------
    start, stop : int
        Range of steps.
    failed : int
        Steps that could not be measured.
    messages : tuple of str
        A sentence about each bad frame.
    """

    start: int
    stop: int
    failed: int
    messages: tuple[str, ...]


@dataclass(frozen=True)
class Work:
    """Measures one block and writes it: what a worker is sent.

    Parameters
    ----------
    store : path
        Where to write.
    plan : wavefield.measurement.Plan
        Pickles as rig, grid and settings; computed once per process.
    frame_rate : float
        Hz.
    """

    store: Path
    plan: Any
    frame_rate: float

    def __call__(self, block: Block) -> Report:
        """Measure and write.

        Parameters
        ----------
        block : Block
            Steps and frames.

        Returns
        -------
        Report
        """
        measured = measure_block(block, self.plan, self.frame_rate)
        write_block(
            self.store,
            block.start,
            measured.fields,
            measured.frame_status,
            measured.faults,
            measured.shifts,
        )
        failed = int(np.count_nonzero(measured.frame_status == FrameStatus.FAILED))
        return Report(block.start, block.stop, failed, tuple(measured.messages))
