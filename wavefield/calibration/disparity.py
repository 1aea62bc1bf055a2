"""Disparity between dewarped images of a light sheet, from the correlation of many instants together.

Particles of a sheet of some thickness are not matched one by one: each camera sees them displaced by their
height. Summed over instants, their correlation is an elongated peak about the disparity of its middle.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavefield.calibration.points import Image, Mask
from wavefield.rig.lens import Array

LIGHT_SCALE = 4.0  # px: variations wider than a few particles are illumination
MAX_BRIGHTNESS = 4.0  # standard deviations: brighter particles are limited to this
SMOOTHING = 1.5  # px: of the correlation, so that single particles do not make peaks of their own
PEAK_LEVEL = 0.5  # of the maximum: correlations above it belong to the peak
MIN_PEAK = 6.0  # standard deviations of the correlation around the peak, for a peak to be significant
MIN_SAMPLES = 12  # of a peak, for its widths


def particles(image: Image, visible: Mask) -> Image:
    """The particles of an image: illumination removed, brightness limited; 0 where nothing is visible."""
    weight = cv2.GaussianBlur(visible.astype(np.float32), (0, 0), LIGHT_SCALE)
    light = cv2.GaussianBlur(np.where(visible, image, np.float32(0)), (0, 0), LIGHT_SCALE)
    rest = np.where(visible, image - light / np.maximum(weight, 1e-3), np.float32(0))
    spread = np.float32(np.sqrt(np.mean(np.square(rest[visible])))) if visible.any() else np.float32(0)
    if not spread > 0:
        return np.zeros_like(rest)
    out: Image = np.clip(rest / spread, -MAX_BRIGHTNESS, MAX_BRIGHTNESS)
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

    def add(self, a: Image, b: Image) -> None:
        """Add an instant: images as from `particles`."""
        for i, row in enumerate(self.rows):
            lines = slice(row, row + self.side)
            pieces = np.stack([[q[lines, c : c + self.side] for c in self.columns] for q in (a, b)])
            spectrum = scipy.fft.rfft2(pieces * self._taper, workers=1)
            self._sum[i] += np.conj(spectrum[0]) * spectrum[1]
            self._own += np.square(np.abs(spectrum)).sum(axis=(0, 1))

    def planes(self) -> Image:
        """Correlation of every window, (rows, columns, side, side): no displacement in the middle."""
        return self._plane(self._sum)

    def own(self) -> Image:
        """Correlation of the images with themselves, all windows and both images together, (side, side)."""
        return self._plane(self._own)

    def _plane(self, spectrum: NDArray[np.complexfloating | np.floating]) -> Image:
        plane = scipy.fft.fftshift(scipy.fft.irfft2(spectrum, s=(self.side, self.side)), axes=(-2, -1))
        out = np.ascontiguousarray(plane, np.float32)
        for one in _each(out):
            one[:] = cv2.GaussianBlur(one, (0, 0), SMOOTHING)
        return out


def _each(planes: Image) -> Iterator[Image]:
    yield from planes.reshape(-1, *planes.shape[-2:])


def disparities(planes: Image) -> Array:
    """Displacement (n, m, 2), px along x and y, of the second image in windows (n, m, side, side)."""
    return np.array([_centre(one) for one in _each(planes)]).reshape(*planes.shape[:2], 2)


def _centre(plane: Image) -> tuple[float, float]:
    """Centre of the peak above half of its maximum; NaN where it is not significant or cut off."""
    middle, peak = plane.shape[0] // 2, _peak(plane)
    background = plane[~cv2.dilate(peak.view(np.uint8), np.ones((9, 9), np.uint8)).view(bool)]
    if not background.size or plane.max() - np.median(background) < MIN_PEAK * background.std():
        return np.nan, np.nan
    row, column = np.nonzero(peak)
    weight = plane[peak] - PEAK_LEVEL * plane.max()
    if row.min() == 0 or column.min() == 0 or max(row.max(), column.max()) == plane.shape[0] - 1:
        return np.nan, np.nan
    return float(weight @ column / weight.sum()) - middle, float(weight @ row / weight.sum()) - middle


def _peak(plane: Image) -> Mask:
    """Samples connected with the maximum that are above half of it."""
    top = np.unravel_index(int(plane.argmax()), plane.shape)
    _, parts = cv2.connectedComponents((plane > PEAK_LEVEL * plane.max()).astype(np.uint8))
    return np.asarray(parts == parts[top])


def peak_length(planes: Image, own: Image, shift: Array, along: Array) -> float:
    """Standard deviation, px, that a particle's height adds to the peaks along the disparity (n, m, 2).
    Less the peaks' width across and the size of the particles' images; Wieneke (2005), Exp. Fluids 39, 267.
    """
    middle = np.full(2, own.shape[0] // 2)
    variances = [
        _excess_variance(plane, centre + middle, way / np.linalg.norm(way))
        for plane, centre, way in zip(_each(planes), shift.reshape(-1, 2), along.reshape(-1, 2), strict=True)
        if np.isfinite(centre).all()
    ]
    if not variances:
        return float("nan")
    mean_way = np.mean(along.reshape(-1, 2), axis=0)
    own_variance = _excess_variance(own, middle, mean_way / np.linalg.norm(mean_way))
    return float(np.sqrt(max(float(np.median(variances)) - own_variance, 0.0)))


def _excess_variance(plane: Image, centre: Array, way: Array) -> float:
    """Variance of one peak along a direction less that across it, px^2."""
    peak = _peak(plane)
    row, column = np.nonzero(peak)
    place = np.stack([column - centre[0], row - centre[1]])
    s, t = way @ place, np.array([-way[1], way[0]]) @ place
    design = np.stack([np.ones(s.size), s, t, -0.5 * s * s, -0.5 * t * t, s * t], axis=1)
    if len(design) < MIN_SAMPLES:
        return 0.0
    # the logarithm's curvature above half of the maximum: second moments depend on where a peak is cut off
    fit = np.linalg.lstsq(design, np.log(plane[peak]), rcond=None)[0]
    return float(1.0 / fit[3] - 1.0 / fit[4]) if fit[3] > 0 and fit[4] > 0 else 0.0
