"""Beads stand above the water: what is seen of them swings as the surface tilts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[Any]

_UNKNOWN = 0.2  # of a height: what is seen of a bead changes with light and view


def bead_tilt(rise: Float, step: float, height: float) -> tuple[Float, Float]:
    """What beads move beyond the water that carries them.

    What stands h above the water along its normal lies -h grad z beside it, so that it moves by
    -h d(grad z)/dt more: of a wave (1 - h k) of the horizontal motion is seen.

    With rise (ny, nx), metres; step, metres; height, metres; returns moved, std (2, ny, nx): Motion per step
    along x and y beyond the water's, and its standard uncertainty, metres.

    Examples
    --------
    A surface that tilts by .1 about the y axis in a step:

    >>> rise = 0.1 * np.tile(np.arange(4) * 0.01, (3, 1))
    >>> along_x, along_y = bead_tilt(rise, 0.01, 4e-4)[0][:, 1, 1]
    >>> f"{1e6 * along_x:.0f} um along x, {abs(along_y):.0f} along y"
    '-40 um along x, 0 along y'
    """
    along_y, along_x = np.gradient(rise, step)
    moved = np.nan_to_num(-height * np.stack([along_x, along_y]))
    return moved, _UNKNOWN * np.abs(moved)
