"""Jitter of the frame times, from stored velocities that are too large and too small in turn.

All cameras share the time of a frame. Where it comes late, all displacements of the step before it are too
large and those of the step after it too small, by one factor over the whole field (`step_continuity`). What
waves change in a step differs from place to place, jitter does not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special  # scipy.stats takes half a second to import

from wavefield.quality.step_continuity import MIN_CELLS, MIN_STEPS, StepFactors
from wavefield.variables import PATH_WEIGHTS

Array = NDArray[np.floating]

_CHANCE = 1e-3  # of a sound record with as large a difference between steps
_INDEPENDENT_DIFFERENCES = 2.0 / 3.0  # of all
_VARYING_MISFIT = 0.25  # of the squared misfit: how fast waves turn varies, by less than half of it


@dataclass(frozen=True)
class FrameJitter:
    """Jitter of the frame times, rms, in frame intervals, and the relative error of velocities by it."""

    intervals: float
    velocity: float


def frame_jitter(steps: StepFactors, path_frames: int) -> FrameJitter | None:
    """Jitter from how steps of paths of so many frames continue each other; None where none shows.
    Differences of consecutive factors have to show it as well: how far waves are predicted changes slowly.
    """
    known = np.isfinite(steps.factor)
    both = np.flatnonzero(known[1:] & known[:-1])
    if both.size < MIN_STEPS - 1:
        return None
    median = float(np.median(steps.factor[known]))
    spread = float(np.var(steps.factor[known], ddof=1)) / median**2
    between = 0.5 * float(np.mean(np.square(np.diff(steps.factor)[both]))) / median**2
    within = float(np.mean(steps.variance[known])) / median**2
    freedom = _INDEPENDENT_DIFFERENCES * both.size, int(known.sum()) * (MIN_CELLS - 1)
    by_chance = within * float(special.fdtri(*freedom, 1.0 - _CHANCE))
    if min(between, spread) <= max(by_chance, _VARYING_MISFIT * (median - 1.0) ** 2):
        return None
    half = PATH_WEIGHTS[path_frames]
    velocity = np.convolve([*half[:0:-1], *half], [1.0, -1.0])  # errors of frame times in a step
    changes = [
        np.convolve(np.append(0.0, steps.weights[k + 1]) - np.append(steps.weights[k], 0.0), velocity)
        for k in both
    ]
    few = 1.0 + 2.0 / freedom[0]  # a variance from few steps is as likely too small
    sigma = np.sqrt(few * (between - within) / (0.5 * np.mean(np.sum(np.square(changes), axis=1))))
    return FrameJitter(float(sigma), float(sigma * np.linalg.norm(velocity)))
