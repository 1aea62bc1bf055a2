"""Find the position of a peak between samples."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Samples = float | NDArray[Any]


def parabola_vertex(before: Samples, middle: Samples, after: Samples) -> NDArray[Any]:
    """Return the position of the maximum of the parabola through three equidistant samples, elementwise.
    It is relative to the sample `middle`, in sample intervals, positive towards `after`. It is 0 if the
    parabola has no maximum."""
    bend = before - 2 * middle + after
    return np.asarray(0.5 * (before - after) / np.where(bend < 0, bend, -np.inf))
