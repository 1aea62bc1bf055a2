"""Position of a peak between samples."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Samples = float | NDArray[Any]


def parabola_vertex(before: Samples, middle: Samples, after: Samples) -> NDArray[Any]:
    """Return the position of the maximum of the parabola through three equidistant samples, elementwise.
    The position is the distance from the middle sample towards `after`, in sample intervals; it is 0 if the
    parabola has no maximum."""
    bend = before - 2 * middle + after
    return np.asarray(0.5 * (before - after) / np.where(bend < 0, bend, -np.inf))
