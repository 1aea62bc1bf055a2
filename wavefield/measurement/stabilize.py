"""Correct frames of cameras that shake before they are measured: `settings: {vibration: correct}`.

In every frame, the part of the epipolar error between the reference and each other camera that is constant or
linear over the field is measured. An affine map of the raw image removes it, across the sight lines. Motion
along the sight lines cannot be separated from that of the water. The correction of a frame uses the images of
this frame alone, so it does not depend on chunks or workers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.images import prepare, ready, usable
from wavefield.measurement.pair import match_pair
from wavefield.rig.stereo import parallax
from wavefield.robust import PER_MEDIAN, reweighted_lstsq
from wavefield.variables import AROUND

Array = NDArray[Any]
Images = Mapping[str, Array | None]

BLOCKS_APART = 5  # step between the blocks that are used: closer ones share their window
MIN_FITTED_BLOCKS = 40  # fewest blocks for a fit: ten for each of three coefficients, and ten outliers
MIN_COSINE = 0.9  # 25 degrees: largest angle between the directions across the sight lines of two pairs


def refuse_unless_in_a_row(geometry: GridGeometry) -> None:
    """Raise ExperimentError unless all pairs have about the same direction across their sight lines."""
    x, y = np.mean(geometry.grid.x), np.mean(geometry.grid.y)
    first, *others = geometry.pairs
    for pair in others:
        cosine = abs(float(_across(geometry, pair, x, y) @ _across(geometry, first, x, y)))
        if cosine <= MIN_COSINE:
            raise ExperimentError(
                f"`vibration: correct` is for cameras in a row: the sight lines of {'-'.join(first)} and of "
                f"{'-'.join(pair)} part in directions {np.degrees(np.arccos(cosine)):.0f} degrees apart, and "
                "which camera shakes cannot be determined; leave `vibration` out of the settings, or measure "
                "z with two cameras (`surface: {pairs: ...}`)"
            )


def steady(frames: Mapping[str, Sequence[Array | None]], geometry: GridGeometry) -> dict[str, SteadyFrames]:
    """Return the frames of every camera, corrected for shaking; each is computed when it is first read."""
    kept: dict[int, dict[str, Array | None]] = {}
    return {name: SteadyFrames(name, frames, geometry, kept) for name in frames}


class SteadyFrames(Sequence["Array | None"]):
    """Corrected frames of one camera; all cameras share a cache of the last few frames."""

    _KEEP = 2 * AROUND + 2  # frames in the cache: as many as a step uses

    def __init__(
        self,
        name: str,
        frames: Mapping[str, Sequence[Array | None]],
        geometry: GridGeometry,
        kept: dict[int, dict[str, Array | None]],
    ) -> None:
        self._name, self._frames, self._geometry, self._kept = name, frames, geometry, kept

    def __len__(self) -> int:
        return len(self._frames[self._name])

    def __getitem__(self, position: Any) -> Any:
        if position not in self._kept:
            images = {name: one[position] for name, one in self._frames.items()}
            self._kept[position] = corrected(images, self._geometry)
            while len(self._kept) > self._KEEP:
                del self._kept[next(iter(self._kept))]
        return self._kept[position][self._name]


def corrected(images: Images, geometry: GridGeometry) -> dict[str, Array | None]:
    """Return the raw images of one instant, corrected for shaking; unchanged if that cannot be determined."""
    out = dict(images)
    for name, shift in _shifts(images, geometry).items():
        image = images[name]
        if image is not None:
            out[name] = _moved_back(image, shift, name, geometry)
    return out


def _shifts(images: Images, geometry: GridGeometry) -> dict[str, Array]:
    """Return each camera's shift across the sight lines minus their median, rectified px; empty if unknown.
    A shift (3,) is the value in the middle and its changes to the right and to the upper edge."""
    flat = {}
    for name in geometry.surface_cameras:
        image = images.get(name)
        if image is None or not usable(image, geometry.rig[name].size):
            return {}
        flat[name] = prepare(ready(image, geometry.sights[name].binning, None), name, geometry)
    found = {geometry.reference: np.zeros(3)}
    x, y = np.meshgrid(geometry.lattice.x, geometry.lattice.y)
    cells = np.s_[::BLOCKS_APART, ::BLOCKS_APART]
    first = _across(geometry, geometry.pairs[0], x.mean(), y.mean())
    for a, b in geometry.pairs:
        match = match_pair(flat[a], flat[b], (a, b), geometry)
        used = match.matched[cells]
        error = match.eps_y[cells][used] / geometry.pixel
        if len(error) < MIN_FITTED_BLOCKS:
            return {}
        low = reweighted_lstsq(_linear(x, y)[cells][used], error, np.ones(len(error)), _huber, 6)[0]
        found[b] = np.sign(first @ _across(geometry, (a, b), x.mean(), y.mean())) * low
    usual = np.median(list(found.values()), axis=0)
    return {name: low - usual for name, low in found.items()}


def _linear(x: Array, y: Array) -> Array:
    """Return 1, x and y as regressors, (..., 3), with x and y scaled to the range -1 to 1."""
    scaled = [2 * (v - v.min()) / max(np.ptp(v), 1e-9) - 1 for v in (x, y)]
    return np.stack([np.ones_like(x), *scaled], axis=-1)


def _huber(residual: Array) -> Array:
    """Return the square roots of Huber's weights, below 1 for residuals beyond two robust deviations."""
    miss = np.abs(residual)
    bound = 2.0 * (PER_MEDIAN * np.median(miss) + 1e-9)
    return np.asarray(np.sqrt(np.minimum(1.0, bound / np.maximum(miss, 1e-12))))


def _across(geometry: GridGeometry, pair: tuple[str, str], x: Any, y: Any) -> Array:
    """Return unit vectors (2, ...) across the sight lines of a pair at x, y, m, the direction of eps_y."""
    dx, dy = parallax(geometry.rig, pair, x, y)
    return np.asarray(np.stack([-dy, dx]) / np.maximum(np.hypot(dx, dy), 1e-12))


def _moved_back(image: Array, shift: Array, name: str, geometry: GridGeometry) -> Array:
    """Return a raw image (row, column) of the camera `name`, moved back by its shift (3,) from `_shifts`."""
    x, y = np.meshgrid(geometry.lattice.x, geometry.lattice.y)
    size = (_linear(x, y) @ shift * geometry.pixel)[::8, ::8].ravel()
    x, y = x[::8, ::8].ravel(), y[::8, ::8].ravel()
    dx, dy = -size * _across(geometry, geometry.pairs[0], x, y)
    camera = geometry.rig[name]
    before = np.stack(camera.project(x, y, 0.0), axis=-1)
    after = np.stack(camera.project(x + dx, y + dy, 0.0), axis=-1)
    design = np.column_stack([before, np.ones(len(before))])
    affine = np.linalg.lstsq(design, after - before, rcond=None)[0].T + np.eye(2, 3)
    flat = np.ascontiguousarray(image, np.float32)
    size_px = image.shape[1], image.shape[0]
    out = cv2.warpAffine(flat, affine, size_px, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    return np.maximum(np.asarray(out, np.float32), 0)
