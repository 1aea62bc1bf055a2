"""How far the water moves between two frames: a coarse search over the record, before it is measured.

The matching starts from a search of whole pixels within a range. Here that range is found from the images
themselves, once per run, and written into the recipe, so that every block of the run starts alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.measurement_settings import Settings

PATCH_PX = 64  # side of the patches that are searched for
REACH_PX = 256
PATCHES_ACROSS = 6  # along each side of an image
MIN_CORRELATION = 0.25  # no more is left of particles that leave a light sheet
MIN_CORRELATION_SMALL = 0.4  # of the smaller patches of small images, which correlate more by chance
MAX_SECOND_BEST = 0.85  # correlation over the best, above which the match is ambiguous
AGREEMENT_PX = 8.0  # patches that moved alike differ by less than this and a quarter of their motion
REFINEMENT_PX = 4  # around where images of half the size have a patch
MARGIN_PX = 12.0  # added to the range found, and a quarter of its span

Float = NDArray[np.float32]


@dataclass(frozen=True)
class FirstGuess:
    """Range of the displacements from one frame to the next."""

    x: tuple[float, float]  # smallest and largest displacement, px of the image as it is matched
    y: tuple[float, float]
    found: int  # patches of images that were found again, and all that were searched for
    tried: int
    steps: int  # steps searched

    def search(self, usual: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Ranges to search along x and y, px; None where the usual one suffices or nothing was found."""
        if not self.found:
            return None
        if all(low >= usual[0] and high <= usual[1] for low, high in (self.x, self.y)):
            return None
        return _widened(self.x), _widened(self.y)

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
            f"({self.found} of {self.tried} patches of {self.steps} steps found)"
        )


def _widened(ends: tuple[float, float]) -> tuple[float, float]:
    margin = MARGIN_PX + 0.25 * (ends[1] - ends[0])
    return float(np.floor(ends[0] - margin)), float(np.ceil(ends[1] + margin))


def shifts(
    a: Float, b: Float, side: int = PATCH_PX, reach: tuple[int, int] = (REACH_PX, REACH_PX)
) -> NDArray[np.float64]:
    """Whole-pixel displacement of patches of one image to the next.

    Normalised correlation of the patches within the reach around their place. A patch counts if its best
    correlation exceeds 0.25 (0.4 where images are too small for patches of 64 px) and all others further than
    3 px from it are less than 0.85 of that. Large patches are searched for in images of half the size, and
    then within a few pixels of where they were found. Returns (n, 5): displacement along x and y, px, NaN
    where not found, correlation, and middle (x, y) of every patch with contrast.
    """
    a, b = (np.asarray(image, np.float32) for image in (a, b))  # of any depth
    height, width = a.shape
    size = min(side, height // 4, width // 4)
    if size < 16:
        return np.zeros((0, 5))
    rows = np.linspace(0, height - size, PATCHES_ACROSS).astype(int)
    columns = np.linspace(0, width - size, PATCHES_ACROSS).astype(int)
    contrast = float(a.std())
    small_a, small_b = _half(a), _half(b)
    out = []
    for y in rows.tolist():
        for x in columns.tolist():
            patch = a[y : y + size, x : x + size]
            if not float(patch.std()) > 0.2 * contrast:
                continue
            middle = x + 0.5 * (size - 1), y + 0.5 * (size - 1)
            if size < PATCH_PX:
                found = _found(a, b, (x, y), size, reach, MIN_CORRELATION_SMALL)
            else:
                found = _found(small_a, small_b, (x // 2, y // 2), size // 2, (reach[0] // 2, reach[1] // 2))
                found = _refined(a, b, (x, y), size, found)
            out.append((*found, *middle))
    return np.array(out, float).reshape(-1, 5)


def _half(image: Float) -> Float:
    height, width = image.shape
    small = cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)


def _refined(
    a: Float, b: Float, at: tuple[int, int], size: int, found: tuple[float, float, float]
) -> tuple[float, float, float]:
    """The same patch in the images of full size, near where it was found in those of half the size."""
    if not np.isfinite(found[0]):
        return found
    dx, dy = (int(2 * d) for d in found[:2])
    x, y = at[0] + dx, at[1] + dy
    x0, y0 = max(0, x - REFINEMENT_PX), max(0, y - REFINEMENT_PX)
    score = _scores(
        a[at[1] : at[1] + size, at[0] : at[0] + size],
        b[y0 : y + size + REFINEMENT_PX, x0 : x + size + REFINEMENT_PX],
    )
    _, best, _, (column, row) = cv2.minMaxLoc(score)
    if not best > MIN_CORRELATION:
        return np.nan, np.nan, float(best)
    return float(x0 + column - at[0]), float(y0 + row - at[1]), float(best)


def _scores(patch: Float, around: Float) -> Float:
    score = cv2.matchTemplate(np.ascontiguousarray(around), np.ascontiguousarray(patch), cv2.TM_CCOEFF_NORMED)
    return np.asarray(score, np.float32)


def _found(
    a: Float,
    b: Float,
    at: tuple[int, int],
    size: int,
    reach: tuple[int, int],
    min_correlation: float = MIN_CORRELATION,
) -> tuple[float, float, float]:
    """Displacement of one patch and its correlation; NaN where it is not found or ambiguous."""
    x0, y0 = max(0, at[0] - reach[0]), max(0, at[1] - reach[1])
    patch = a[at[1] : at[1] + size, at[0] : at[0] + size]
    score = _scores(patch, b[y0 : at[1] + size + reach[1], x0 : at[0] + size + reach[0]])
    _, best, _, (column, row) = cv2.minMaxLoc(score)
    rest = score.copy()
    rest[max(0, row - 3) : row + 4, max(0, column - 3) : column + 4] = -1.0
    if not best > min_correlation or rest.max() > MAX_SECOND_BEST * best:
        return np.nan, np.nan, float(best)
    return float(x0 + column - at[0]), float(y0 + row - at[1]), float(best)


def confirmed(moved: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacements (n, 2), px, that another patch of the same images nearly shares, (m, 2)."""
    moved = moved[np.isfinite(moved[:, 0])]
    apart = np.hypot(*(moved[:, None] - moved).T) - AGREEMENT_PX - 0.25 * np.hypot(*moved.T)
    out: NDArray[np.float64] = moved[(apart < 0).sum(axis=0) > 1]
    return out


def first_guess(
    read: Callable[[str, int], NDArray[np.float32] | None], cameras: Sequence[str], steps: Sequence[int]
) -> FirstGuess:
    """Range of the displacements in some steps of a record."""
    kept: list[NDArray[np.float64]] = []
    tried = seen = 0
    for step in steps:
        for name in cameras:
            a, b = read(name, step), read(name, step + 1)
            if a is None or b is None:
                continue
            seen += name == cameras[0]
            moved = shifts(np.asarray(a, np.float32), np.asarray(b, np.float32))
            tried += len(moved)
            kept.append(confirmed(moved[:, :2]))
    found = np.concatenate(kept) if kept else np.zeros((0, 2))
    if not len(found):
        return FirstGuess((0.0, 0.0), (0.0, 0.0), 0, tried, seen)
    (x0, y0), (x1, y1) = found.min(axis=0).tolist(), found.max(axis=0).tolist()
    return FirstGuess((x0, x1), (y0, y1), len(found), tried, seen)


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
