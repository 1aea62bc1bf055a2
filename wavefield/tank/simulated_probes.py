"""What wave probes record: the elevation at fixed places."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wavefield.atomic_write import NEW_FILE, write_text
from wavefield.tank.sea import Sea

Array = NDArray[np.float64]


def record(sea: Sea, positions: Mapping[str, tuple[float, float]], times: Array) -> Array:
    """Exact elevation at the probes.

    With positions (x, y), metres; times (n,); returns (n, number of probes): Metres.
    """
    x, y = np.array(list(positions.values()), float).reshape(-1, 2).T
    return np.array([sea.at(x, y, time, ("z",))["z"] for time in times]).reshape(len(times), x.size)


def write(path: Path, times: Array, positions: Mapping[str, tuple[float, float]], z: Array) -> None:
    """Write a record as CSV.

    With times (n,); positions (x, y), metres; z (n, number of probes), metres.
    """
    lines = [f"# {name} {x:.6g} {y:.6g}" for name, (x, y) in positions.items()]
    lines.append(",".join(["time", *positions]))
    lines += [
        f"{t:.6f}," + ",".join(f"{value:.6f}" for value in row) for t, row in zip(times, z, strict=True)
    ]
    write_text(path, "\n".join(lines) + "\n", NEW_FILE)
