"""Series of what is worked out from the stored variables, at one node: from the cube, not its preview."""

from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import DERIVED
from wavefield.store.preview import read_steps
from wavefield.variables import CUBE_DIMS
from wavefield.waves.nonlinear.kinematics import kinematics

_BESIDE = 3  # nodes that differences of sixth order reach to either side
_BALANCE = ("z", "z_t", "u", "v", "w")


def derived_series(
    record: CubeRecord, j: int, i: int, progress: Callable[[float], None] | None = None
) -> dict[str, NDArray[np.float32]]:
    """All derived variables at one node over the whole record.

    Differences want the neighbours of the node, which a thinned preview has not: the nodes around it are read
    from every block, once for all. What comes out is what `wavefield.waves.nonlinear.kinematics` gives for
    the cube.

    Returns (time,): Those of `wavefield.explorer.map_fields.DERIVED` whose variables the cube has, in their
    units.
    """
    names = [name for name in DERIVED if name in record.names]
    steps = record.layout.steps
    rows, columns = (slice(max(k - _BESIDE, 0), k + _BESIDE + 1) for k in (j, i))
    out = {name: np.full(steps, np.nan, np.float32) for name in names}
    blocks = record.layout.chunks() if names else []
    for number, (start, stop) in enumerate(blocks):
        if record.ledger[start:stop].any():
            first, last = max(start - 1, 0), min(stop + 1, steps)
            around = xr.Dataset(
                {
                    n: (
                        CUBE_DIMS,
                        read_steps(record.group, n, first, last, rows, columns),
                        dict(record.group[n].attrs),
                    )
                    for n in _BALANCE
                },
                coords={"time": record.time[first:last], "y": record.y[rows], "x": record.x[columns]}
                | record.paths,
            )
            found = kinematics(around)
            for name, series in out.items():
                values = found[name].values
                series[start:stop] = values[start - first : stop - first, j - rows.start, i - columns.start]
        if progress is not None:
            progress((number + 1) / len(blocks))
    return out
