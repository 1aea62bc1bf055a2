"""How far the water moves between two frames: a coarse search over the record, before it is measured.

The matching starts from a search of whole pixels within a range. Here that range is found from the images
themselves, once per run, and written into the recipe, so that every block of the run starts alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.patch_shifts import confirmed, shifts, widened
from wavefield.measurement.measurement_settings import Settings


@dataclass(frozen=True)
class FirstGuess:
    """Range of the displacements from one frame to the next."""

    x: tuple[float, float]  # smallest and largest displacement, px of the image as it is matched
    y: tuple[float, float]
    found: int  # patches of images that were found again, and all that were searched for
    tried: int

    def search(self, usual: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Ranges to search along x and y, px; None where the usual one suffices or nothing was found."""
        if not self.found:
            return None
        if all(low >= usual[0] and high <= usual[1] for low, high in (self.x, self.y)):
            return None
        return widened(self.x), widened(self.y)

    @property
    def sentence(self) -> str:
        """The range in words."""
        if self.found < 0.1 * self.tried:
            return (
                f"motion: only {self.found} of {self.tried} patches of images are found in the next frame; "
                "are frames of one camera in order, bright and seeded, and the step short enough?"
            )
        along = (f"{low:+.0f} to {high:+.0f} px" for low, high in (self.x, self.y))
        return (
            f"motion: {next(along)} along x, {next(along)} along y from frame to frame "
            f"({self.found} of {self.tried} test patches matched)"
        )


def first_guess(
    read: Callable[[str, int], NDArray[np.float32] | None], cameras: Sequence[str], steps: Sequence[int]
) -> FirstGuess:
    """Range of the displacements in some steps of a record."""
    kept: list[NDArray[np.float64]] = []
    tried = 0
    for step in steps:
        for name in cameras:
            a, b = read(name, step), read(name, step + 1)
            if a is None or b is None:
                continue
            moved = shifts(np.asarray(a, np.float32), np.asarray(b, np.float32))
            tried += len(moved)
            kept.append(confirmed(moved[:, :2]))
    found = np.concatenate(kept) if kept else np.zeros((0, 2))
    if not len(found):
        return FirstGuess((0.0, 0.0), (0.0, 0.0), 0, tried)
    (x0, y0), (x1, y1) = found.min(axis=0).tolist(), found.max(axis=0).tolist()
    return FirstGuess((x0, x1), (y0, y1), len(found), tried)


def wide_enough(settings: Settings, guess: FirstGuess) -> Settings:
    """Settings whose search includes the motion of the water."""
    piv = settings.piv
    wide = guess.search(searched(settings)[0])
    if wide is None:
        return settings
    return replace(settings, piv=replace(piv, search_x=wide[0], search_y=wide[1]))


def searched(settings: Settings) -> tuple[tuple[float, float], tuple[float, float]]:
    """Range of displacements that matching in time reaches, along x and along y, px."""
    nothing = (-4.0, 4.0)  # without a search the pyramid reaches a few px
    return settings.piv.search_x or nothing, settings.piv.search_y or nothing


def beyond(settings: Settings, moved: NDArray[np.float64]) -> bool:
    """Whether most of the displacements (n, 2), px, are outside the range that is searched."""
    if len(moved) < 3:
        return False
    out = np.zeros(len(moved), bool)
    for along, (low, high) in zip(moved.T, searched(settings)):
        out |= (along < low) | (along > high)
    return bool(out.mean() > 0.5)
