"""Series of the derived variables at one node, from the cube instead of its thinned preview."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavefield.explorer.cube_record import CubeRecord
from wavefield.figures.display import DERIVED

_REACH = 3  # nodes on either side of one that differences of sixth order use


class SeriesRequest(NamedTuple):
    """A node whose derived series are to be shown."""

    j: int
    i: int
    steps_done: int  # of the cube at the time of the request


def derived_series(
    record: CubeRecord, j: int, i: int, progress: Callable[[float], None] | None = None
) -> dict[str, NDArray[np.float32]]:
    """The derived variables of a cube at one node, as `kinematics` has them, (time,), in stored units.
    Read from every chunk, not from the thinned preview: differences need the nodes around it.
    """
    names = [name for name in DERIVED if name in record.names]
    rows, columns = (slice(max(k - _REACH, 0), k + _REACH + 1) for k in (j, i))
    out = {name: np.full(record.layout.steps, np.nan, np.float32) for name in names}
    chunks = record.layout.chunks() if names else []
    for number, (start, stop) in enumerate(chunks):
        if record.ledger[start:stop].any():
            terms = record.derived(start, stop, rows, columns)
            for name, series in out.items():
                series[start:stop] = terms[name].values[:, j - rows.start, i - columns.start]
        if progress is not None:
            progress((number + 1) / len(chunks))
    return out
