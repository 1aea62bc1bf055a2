"""When the solutions of a MAP field, each with the images evaluated at the last one, have converged."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching import Modes

Float = NDArray[Any]

MIN_EVALUATIONS = 2  # of the images: where matching led, and where the first solution leads
MAX_EVALUATIONS = 6  # where windows have left much of short steep waves and solutions still change
MAX_CHANGE_PX = 0.15  # rms change of the displacement from one solution to the next
MAX_RELATIVE_CHANGE = 0.05  # of the displacement's own rms: the same where there are short waves alone
NEGLIGIBLE_CHANGE_PX = 0.05  # rms: always converged
MAX_FIELD_PX = 1e4  # wider than images: no displacement, the images show too little of one
OSCILLATION_RATIO = 0.7  # of the change before: solutions that change by more oscillate


class Convergence:
    """How solutions change from evaluation to evaluation; `scale` is px per unit of the field."""

    def __init__(self, scale: float = 1.0) -> None:
        self._scale, self._evaluations, self._change = scale, 0, np.inf
        self._allowed, self._diverged = MAX_CHANGE_PX, False

    @property
    def converged(self) -> bool:
        """Whether no further evaluation is needed."""
        return self._diverged or (self._evaluations >= MIN_EVALUATIONS and self._change <= self._allowed)

    def next(self, modes: Modes, waves: Float, solved: Float, seen: Float | None) -> tuple[Float, Float]:
        """Coefficients to continue with and the field that blocks see: half way where solutions oscillate.
        They are those before, if the solution is no displacement of an image.
        """
        after = modes.seen(solved)
        self._diverged = not self._scale * float(np.abs(after).max()) < MAX_FIELD_PX  # NaN is none either
        if self._diverged:
            return waves, modes.seen(waves)
        self._evaluations += 1
        if seen is None:
            return solved, after
        change = self._scale * float(np.sqrt(np.mean(np.square(after - seen))))
        relative = MAX_RELATIVE_CHANGE * self._scale * float(after.std())
        self._allowed = min(MAX_CHANGE_PX, max(NEGLIGIBLE_CHANGE_PX, relative))
        limit = max(OSCILLATION_RATIO * self._change, self._allowed)
        self._change = change
        if self._evaluations > MIN_EVALUATIONS and change > limit:
            half = np.float32(0.5)
            return half * (waves + solved), half * (seen + after)
        return solved, after
