"""Disparity between dewarped images of a light sheet, from the correlation of many instants together.

Particles of a sheet of some thickness are not matched one by one: each camera sees them displaced by their
height. Summed over instants, their correlation is a ridge about where the middle of the sheet is seen.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FLAT = 4.0  # px: what is wider than a few particles is light, not particles
_BRIGHT = 4.0  # standard deviations: brighter particles count no more than this
_SMOOTH = 1.5  # px: of the correlation, so that single particles do not make peaks of their own
_RIDGE = 0.5  # of the peak: what belongs to its ridge
_NOISE = 6.0  # standard deviations of the correlation beside the ridge, above which a peak is one


def particles(image: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """What of an image is particles: even light taken away, none counting for many.

    With image (row, column); seen (row, column); returns (row, column): 0 where nothing is seen.
    """
    weight = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), _FLAT)
    light = cv2.GaussianBlur(np.where(seen, image, np.float32(0)), (0, 0), _FLAT)
    rest = np.where(seen, image - light / np.maximum(weight, 1e-3), np.float32(0))
    spread = np.float32(np.sqrt(np.mean(np.square(rest[seen])))) if seen.any() else np.float32(0)
    if not spread > 0:
        return np.zeros_like(rest)
    out: NDArray[np.float32] = np.clip(rest / spread, -_BRIGHT, _BRIGHT)
    return out


@dataclass
class Correlation:
    """Sum over instants of the correlations of windows of two images."""

    rows: Sequence[int]  # First pixel of the windows, in rows and columns of them
    columns: Sequence[int]
    side: int  # Of the windows, px

    def __post_init__(self) -> None:
        half = self.side // 2 + 1
        shape = len(self.rows), len(self.columns), self.side, half
        self._sum, self._own = np.zeros(shape, np.complex64), np.zeros(shape[2:], np.float32)
        edge = np.hanning(self.side + 2)[1:-1]
        self._taper = np.sqrt(np.outer(edge, edge)).astype(np.float32)

    def add(self, a: NDArray[np.float32], b: NDArray[np.float32]) -> None:
        """Add an instant: images as from `particles`."""
        for i, row in enumerate(self.rows):
            lines = slice(row, row + self.side)
            pieces = np.stack([[q[lines, c : c + self.side] for c in self.columns] for q in (a, b)])
            spectrum = scipy.fft.rfft2(pieces * self._taper, workers=1)
            self._sum[i] += np.conj(spectrum[0]) * spectrum[1]
            self._own += np.square(np.abs(spectrum)).sum(axis=(0, 1))

    def planes(self) -> NDArray[np.float32]:
        """Correlation of every window, (rows, columns, side, side): no displacement in the middle."""
        return self._plane(self._sum)

    def own(self) -> NDArray[np.float32]:
        """Correlation of the images with themselves, all windows and both images together, (side, side)."""
        return self._plane(self._own)

    def _plane(self, spectrum: NDArray[np.complexfloating | np.floating]) -> NDArray[np.float32]:
        plane = scipy.fft.fftshift(scipy.fft.irfft2(spectrum, s=(self.side, self.side)), axes=(-2, -1))
        out = np.ascontiguousarray(plane, np.float32)
        for one in _each(out):
            one[:] = cv2.GaussianBlur(one, (0, 0), _SMOOTH)
        return out


def _each(planes: NDArray[np.float32]) -> Iterator[NDArray[np.float32]]:
    yield from planes.reshape(-1, *planes.shape[-2:])


def disparities(planes: NDArray[np.float32]) -> Array:
    """Displacement of the second image against the first in every window.

    With planes (n, m, side, side); returns (n, m, 2): Along columns and rows, px: the centre of what stands
    above half of the peak.
    """
    return np.array([_centre(one) for one in _each(planes)]).reshape(*planes.shape[:2], 2)


def _centre(plane: NDArray[np.float32]) -> tuple[float, float]:
    middle, ridge = plane.shape[0] // 2, _ridge(plane)
    beside = plane[~cv2.dilate(ridge.view(np.uint8), np.ones((9, 9), np.uint8)).view(bool)]
    if not beside.size or plane.max() - np.median(beside) < _NOISE * beside.std():
        return np.nan, np.nan
    row, column = np.nonzero(ridge)
    weight = plane[ridge] - _RIDGE * plane.max()
    if row.min() == 0 or column.min() == 0 or max(row.max(), column.max()) == plane.shape[0] - 1:
        return np.nan, np.nan  # its other half lies beyond what was looked at
    return float(weight @ column / weight.sum()) - middle, float(weight @ row / weight.sum()) - middle


def _ridge(plane: NDArray[np.float32]) -> NDArray[np.bool_]:
    """What hangs together with the peak above half of it."""
    top = np.unravel_index(int(plane.argmax()), plane.shape)
    _, parts = cv2.connectedComponents((plane > _RIDGE * plane.max()).astype(np.uint8))
    return np.asarray(parts == parts[top])


def ridge_length(planes: NDArray[np.float32], own: NDArray[np.float32], found: Array, along: Array) -> float:
    """How far the particles of a sheet spread along the disparity that their height makes.

    Second moments would hang on where the ridge is cut off; the curvature of the logarithm of what stands
    above half of the peak does not. Wieneke (2005), Exp. Fluids 39, 267.

    With planes, own (n, m, side, side); found (n, m, 2); along (n, m, 2); returns Standard deviation of the
    ridge along it, px, without what it has across and what the particles' own images have along and across.
    """
    middle = np.full(2, own.shape[0] // 2)
    lengths = []
    for plane, at, way in zip(_each(planes), found.reshape(-1, 2), along.reshape(-1, 2), strict=True):
        if np.isfinite(at).all():
            lengths.append(_longer(plane, at + middle, way / np.linalg.norm(way)))
    if not lengths:
        return float("nan")
    unit = np.mean(along.reshape(-1, 2), axis=0)
    variance = float(np.median(lengths)) - _longer(own, middle, unit / np.linalg.norm(unit))
    return float(np.sqrt(max(variance, 0.0)))


def _longer(plane: NDArray[np.float32], at: Array, way: Array) -> float:
    """Variance of one ridge along a direction less that across it, px^2."""
    ridge = _ridge(plane)
    row, column = np.nonzero(ridge)
    place = np.stack([column - at[0], row - at[1]])
    s, t = way @ place, np.array([-way[1], way[0]]) @ place
    design = np.stack([np.ones(s.size), s, t, -0.5 * s * s, -0.5 * t * t, s * t], axis=1)
    if len(design) < 12:
        return 0.0
    fit = np.linalg.lstsq(design, np.log(plane[ridge]), rcond=None)[0]
    return float(1.0 / fit[3] - 1.0 / fit[4]) if fit[3] > 0 and fit[4] > 0 else 0.0
