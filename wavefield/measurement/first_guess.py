"""How far the water moves between two frames: a coarse look over the record, before it is measured.

The matching starts from a search of whole pixels within a range. Here that range is found from the images
themselves, once per run, and written into the recipe, so that every block of the run starts alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.measurement_settings import Settings

TILE = 64  # px: side of the pieces that are looked for
REACH = 256  # px: how far
ACROSS = 6  # pieces along each side of an image
SURE = 0.25  # correlation of a piece that is found: no more is left of particles that leave a light sheet
_SURE_SMALL = 0.4  # of a smaller piece, as small images have them: chance reaches further there
ALONE = 0.85  # second-best correlation over the best, above which there is no telling
NEAR = 8.0  # px: pieces that moved alike differ by less than this and a quarter of their motion
_NEAR = 4  # px: how far a piece is looked for around where images of half the size have it
MARGIN = 12.0  # px added to what was found, and a quarter of its span

Float = NDArray[np.float32]


@dataclass(frozen=True)
class FirstGuess:
    """Range of the displacements from one frame to the next."""

    # (float, float): Smallest and largest displacement that was found, px of the image as it is matched
    x: tuple[float, float]
    y: tuple[float, float]
    found: int  # Pieces of images that were found again, and all that were looked for
    tried: int
    steps: int  # Steps looked at

    def search(self, usual: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Ranges to search along x and y; None where the usual one holds what was found, or nothing was.

        With usual (float, float), px; returns (float, float): Along x and along y, px.
        """
        if not self.found:
            return None
        if all(low >= usual[0] and high <= usual[1] for low, high in (self.x, self.y)):
            return None
        return _widened(self.x), _widened(self.y)

    @property
    def sentence(self) -> str:
        """All this for a person."""
        if self.found < 0.1 * self.tried:
            return (
                f"motion: only {self.found} of {self.tried} pieces of images are found in the next frame; "
                "are frames of one camera in order, bright and seeded, and the step short enough?"
            )
        along = (f"{low:+.0f} to {high:+.0f} px" for low, high in (self.x, self.y))
        return (
            f"motion: {next(along)} along x, {next(along)} along y from frame to frame "
            f"({self.found} of {self.tried} pieces of {self.steps} steps found)"
        )


def _widened(ends: tuple[float, float]) -> tuple[float, float]:
    margin = MARGIN + 0.25 * (ends[1] - ends[0])
    return float(np.floor(ends[0] - margin)), float(np.ceil(ends[1] + margin))


def shifts(
    a: Float, b: Float, side: int = TILE, reach: tuple[int, int] = (REACH, REACH)
) -> NDArray[np.float64]:
    """Whole-pixel displacement of pieces of one image to the next.

    Normalised correlation of the pieces within the reach around their place. A piece counts if its best
    correlation exceeds .25 (.4 where images are too small for pieces of 64 px) and all others further than
    3 px from it are less than .85 of that. Large pieces are looked for in images of half the size, and
    then within a few pixels of where they were found.

    With a, b (row, column); side, px; reach (int, int), px; returns (n, 5): Displacement along x and y, px,
    correlation, and middle (x, y) of every piece that has light and shade.
    """
    a, b = (np.asarray(image, np.float32) for image in (a, b))  # of any depth
    height, width = a.shape
    tile = min(side, height // 4, width // 4)
    if tile < 16:
        return np.zeros((0, 5))
    rows = np.linspace(0, height - tile, ACROSS).astype(int)
    columns = np.linspace(0, width - tile, ACROSS).astype(int)
    contrast = float(a.std())
    small_a, small_b = _half(a), _half(b)
    out = []
    for y in rows.tolist():
        for x in columns.tolist():
            piece = a[y : y + tile, x : x + tile]
            if not float(piece.std()) > 0.2 * contrast:
                continue
            middle = x + 0.5 * (tile - 1), y + 0.5 * (tile - 1)
            if tile < TILE:
                found = _found(a, b, (x, y), tile, reach, _SURE_SMALL)
            else:
                found = _found(small_a, small_b, (x // 2, y // 2), tile // 2, (reach[0] // 2, reach[1] // 2))
                found = _near(a, b, (x, y), tile, found)
            out.append((*found, *middle))
    return np.array(out, float).reshape(-1, 5)


def _half(image: Float) -> Float:
    height, width = image.shape
    small = cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)


def _near(
    a: Float, b: Float, at: tuple[int, int], tile: int, found: tuple[float, float, float]
) -> tuple[float, float, float]:
    """The same piece in the whole images, near where it was found in those of half the size."""
    if not np.isfinite(found[0]):
        return found
    dx, dy = (int(2 * d) for d in found[:2])
    x, y = at[0] + dx, at[1] + dy
    x0, y0 = max(0, x - _NEAR), max(0, y - _NEAR)
    score = _scores(
        a[at[1] : at[1] + tile, at[0] : at[0] + tile], b[y0 : y + tile + _NEAR, x0 : x + tile + _NEAR]
    )
    _, best, _, (column, row) = cv2.minMaxLoc(score)
    if not best > SURE:
        return np.nan, np.nan, float(best)
    return float(x0 + column - at[0]), float(y0 + row - at[1]), float(best)


def _scores(piece: Float, around: Float) -> Float:
    score = cv2.matchTemplate(np.ascontiguousarray(around), np.ascontiguousarray(piece), cv2.TM_CCOEFF_NORMED)
    return np.asarray(score, np.float32)


def _found(
    a: Float, b: Float, at: tuple[int, int], tile: int, reach: tuple[int, int], sure: float = SURE
) -> tuple[float, float, float]:
    """Displacement of one piece and its correlation; NaN where it is not found for sure."""
    x0, y0 = max(0, at[0] - reach[0]), max(0, at[1] - reach[1])
    piece = a[at[1] : at[1] + tile, at[0] : at[0] + tile]
    score = _scores(piece, b[y0 : at[1] + tile + reach[1], x0 : at[0] + tile + reach[0]])
    _, best, _, (column, row) = cv2.minMaxLoc(score)
    rest = score.copy()
    rest[max(0, row - 3) : row + 4, max(0, column - 3) : column + 4] = -1.0
    if not best > sure or rest.max() > ALONE * best:
        return np.nan, np.nan, float(best)
    return float(x0 + column - at[0]), float(y0 + row - at[1]), float(best)


def borne_out(moved: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacements that another piece of the same images shares, nearly.

    With moved (n, 2), px; returns (m, 2).
    """
    moved = moved[np.isfinite(moved[:, 0])]
    apart = np.hypot(*(moved[:, None] - moved).T) - NEAR - 0.25 * np.hypot(*moved.T)
    out: NDArray[np.float64] = moved[(apart < 0).sum(axis=0) > 1]
    return out


def first_guess(
    read: Callable[[str, int], NDArray[np.float32] | None], cameras: Sequence[str], steps: Sequence[int]
) -> FirstGuess:
    """Look at some steps of a record."""
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
            kept.append(borne_out(moved[:, :2]))
    found = np.concatenate(kept) if kept else np.zeros((0, 2))
    if not len(found):
        return FirstGuess((0.0, 0.0), (0.0, 0.0), 0, tried, seen)
    (x0, y0), (x1, y1) = found.min(axis=0).tolist(), found.max(axis=0).tolist()
    return FirstGuess((x0, x1), (y0, y1), len(found), tried, seen)


def wide_enough(settings: Settings, guess: FirstGuess) -> Settings:
    """Settings that search as far as the water moves."""
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
    """Whether most of what is found for sure has moved further than is searched.

    With moved (n, 2), px.
    """
    if len(moved) < 3:
        return False
    out = np.zeros(len(moved), bool)
    for along, (low, high) in zip(moved.T, searched(settings)):
        out |= (along < low) | (along > high)
    return bool(out.mean() > 0.5)
