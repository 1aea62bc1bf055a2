"""Displacements of large image patches by normalised correlation, far beyond the search range of `match`."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.parabola import parabola_vertex

PATCH_PX = 64  # side of the patches
REACH_PX = 256  # largest displacement that is searched, along each axis
PATCHES_ACROSS = 6  # patches along each side of an image
MIN_CORRELATION = 0.25  # particles that leave a light sheet between two frames leave no more than this
MAX_SECOND_BEST = 0.85  # second-largest over largest correlation, above which the match is ambiguous
# two displacements confirm each other within this plus a quarter of their length; a range of displacements is
# widened by this plus a quarter of its span
TOLERANCE_PX = 12.0

Float = NDArray[Any]


def widened(ends: tuple[float, float]) -> tuple[float, float]:
    """Widen a range of displacements (lowest, highest), px, by 12 px plus a quarter of its span at each end.
    The ends are rounded outwards to whole pixels."""
    margin = TOLERANCE_PX + 0.25 * (ends[1] - ends[0])
    return float(np.floor(ends[0] - margin)), float(np.ceil(ends[1] + margin))


def shifts(a: Float, b: Float, reach: tuple[int, int] = (REACH_PX, REACH_PX)) -> NDArray[np.float64]:
    """Find the displacements of large patches from image a to image b, up to `reach` (x, y), px.

    Returns (n, 4), one row for each patch with contrast, px: displacement x and y (multiples of 2; NaN if not
    found), and the x and y of the centre of the patch. The result is empty for images below 256 px.
    """
    a, b = (np.asarray(image, np.float32) for image in (a, b))
    height, width = a.shape
    if min(height, width) < 4 * PATCH_PX:
        return np.zeros((0, 4))
    contrast = 0.2 * float(a.std())
    half = width // 2, height // 2  # each pixel is the mean of 2 x 2 px
    one, other = (cv2.resize(image, half, interpolation=cv2.INTER_AREA) for image in (a, b))
    out = []
    for y in np.linspace(0, height - PATCH_PX, PATCHES_ACROSS).astype(int).tolist():
        for x in np.linspace(0, width - PATCH_PX, PATCHES_ACROSS).astype(int).tolist():
            if float(a[y : y + PATCH_PX, x : x + PATCH_PX].std()) > contrast:
                dx, dy = _found(one, other, (x // 2, y // 2), (reach[0] // 2, reach[1] // 2))
                out.append((2 * dx, 2 * dy, x + 0.5 * (PATCH_PX - 1), y + 0.5 * (PATCH_PX - 1)))
    return np.array(out, float).reshape(-1, 4)


def _correlations(patch: Float, around: Float) -> Float:
    """Return the normalised correlation of a patch at every position inside the larger image `around`."""
    correlations = cv2.matchTemplate(
        np.ascontiguousarray(around), np.ascontiguousarray(patch), cv2.TM_CCOEFF_NORMED
    )
    return np.asarray(correlations, np.float32)


def _found(a: Float, b: Float, at: tuple[int, int], reach: tuple[int, int]) -> tuple[float, float]:
    """Return the displacement (x, y) from a to b, px of halved images, of the patch at column and row `at`.
    It is NaN if no correlation within `reach` (x, y) exceeds MIN_CORRELATION, or if two are about equal."""
    size = PATCH_PX // 2
    x0, y0 = max(0, at[0] - reach[0]), max(0, at[1] - reach[1])
    patch = a[at[1] : at[1] + size, at[0] : at[0] + size]
    correlations = _correlations(patch, b[y0 : at[1] + size + reach[1], x0 : at[0] + size + reach[0]])
    _, best, _, (column, row) = cv2.minMaxLoc(correlations)
    correlations[max(0, row - 3) : row + 4, max(0, column - 3) : column + 4] = -1.0
    if not best > MIN_CORRELATION or correlations.max() > MAX_SECOND_BEST * best:
        return np.nan, np.nan
    return float(x0 + column - at[0]), float(y0 + row - at[1])


def locate(patch: Float, around: Float) -> tuple[float, float, float]:
    """Return the column and row where a patch fits best into the image `around`, and the correlation there.
    The position, with fractions, is that of the patch's first pixel; NaN if it is at the border of the range.
    """
    correlations = _correlations(patch, around)
    _, best, _, (column, row) = cv2.minMaxLoc(correlations)
    if not (0 < row < correlations.shape[0] - 1 and 0 < column < correlations.shape[1] - 1):
        return np.nan, np.nan, float(best)
    dx = parabola_vertex(*correlations[row, column - 1 : column + 2].astype(float))
    dy = parabola_vertex(*correlations[row - 1 : row + 2, column].astype(float))
    return float(column + dx), float(row + dy), float(best)


def confirmed(moved: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rows of `moved`, displacements (m, 2) of patches in px, that agree with another row.
    Two displacements agree if they differ by less than 12 px plus 25 % of their length. NaN never agree."""
    moved = moved[np.isfinite(moved[:, 0])]
    apart = np.hypot(*(moved[:, None] - moved).T) - TOLERANCE_PX - 0.25 * np.hypot(*moved.T)
    return np.asarray(moved[(apart < 0).sum(axis=0) > 1])
