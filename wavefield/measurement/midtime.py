"""Elevation and rate of rise half-way between two frames, from the six frames around."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.elevation import Surface
from wavefield.variables import PATH_WEIGHTS

Float = NDArray[Any]
Surfaces = Sequence[Surface | None]

F = np.float32


def at_mid_time(surfaces: Surfaces, path_frames: int = 4) -> tuple[Float, Float, Float]:
    """Elevation, its standard uncertainty and its rise per step.

    Parameters
    ----------
    surfaces : sequence of six Surface or None
        Of two frames before, of the two frames of the step, which must be there, and of two after.
    path_frames : int, default 4
        Frames that the rise comes from, 4 or 6, as velocities do.

    Returns
    -------
    z, std, rise : ndarray of float32, (ny, nx)
        Metres.

    Notes
    -----
    z = (150 (z_0 + z_1) - 25 (z_-1 + z_2) + 3 (z_-2 + z_3)) / 256, a polynomial of fifth degree through six
    frames; without one of the outermost (9 (z_0 + z_1) - z_-1 - z_2) / 16, a cubic through four. Where a
    neighbour is missing a parabola serves, (3 z_0 + 6 z_1 - z_2) / 8; where both are, the mean.

    z_t dt is the mean of the rises from frame to frame by the weights that displacements have along a path
    (`wavefield.variables.PATH_WEIGHTS`), so that z_t changes with w: (26 r - r_before - r_after) / 24 from
    four frames, z_1 - z_0 where a neighbour is missing.

    The same beads in the same places err the same way in all frames, so their errors do not average out.

    Examples
    --------
    >>> def flat(z):
    ...     field = np.full((1, 1), z, np.float32)
    ...     return Surface(field, field, field, np.ones((1, 1), np.uint8), np.zeros((1, 1), bool))
    >>> fifth = [flat(t**5 + t**4) for t in (-2.5, -1.5, -0.5, 0.5, 1.5, 2.5)]
    >>> float(at_mid_time(fifth)[0][0, 0])
    0.0
    """
    far_before, before, first, second, after, far_after = surfaces
    assert first is not None
    assert second is not None
    std = F(0.5) * (first.std + second.std)
    rise = _mean_rise(surfaces, path_frames)
    if before is not None and after is not None:
        pair, next_to = first.z + second.z, before.z + after.z
        if far_before is not None and far_after is not None:
            z = (F(150) * pair - F(25) * next_to + F(3) * (far_before.z + far_after.z)) / F(256)
        else:
            z = (F(9) * pair - next_to) / F(16)
        return z, std, rise
    if after is not None:
        return (F(3) * first.z + F(6) * second.z - after.z) / F(8), std, rise
    if before is not None:
        return (F(3) * second.z + F(6) * first.z - before.z) / F(8), std, rise
    return F(0.5) * (first.z + second.z), std, rise


def _mean_rise(surfaces: Surfaces, path_frames: int) -> Float:
    """From so many frames, or from as many as are there on both sides."""
    weights = PATH_WEIGHTS[min(path_frames, frames_used(surfaces) // 2 * 2)]
    rise: Float = np.zeros((), F)
    for n, (own, beside) in enumerate(pairwise((*weights, 0.0))):
        earlier, later = surfaces[2 - n], surfaces[3 + n]
        assert earlier is not None
        assert later is not None
        rise = rise + F(own - beside) * (later.z - earlier.z)
    return rise


def frames_used(surfaces: Surfaces) -> int:
    """Number of frames that z at mid-time comes from: 6, 4, 3 or 2.

    Parameters
    ----------
    surfaces : sequence of six Surface or None
        As for `at_mid_time`.

    Returns
    -------
    int
    """
    there = [one is not None for one in surfaces]
    if there[1] and there[4]:
        return 6 if there[0] and there[5] else 4
    return 3 if there[1] or there[4] else 2
