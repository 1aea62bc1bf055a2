"""Frames of cameras that shake, turned back before they are measured: ``settings: {vibration: correct}``.

Of every frame the low-order part of eps_y between the reference camera and each other one (constant, and
linear along x and y) is measured and taken off by an affine map of the raw image, across the sight lines.
Motion along them cannot be separated from the water's. A frame's correction follows from that frame's images
alone, so that neither blocks nor workers matter; it is kept in the cube as ``camera_shift``.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError
from wavefield.rig.stereo import parallax
from wavefield.robust import PER_MEDIAN, reweighted_lstsq
from wavefield.variables import AROUND

if TYPE_CHECKING:
    from wavefield.measurement import GridGeometry

Array = NDArray[np.float64]
Image = NDArray[Any]

BLOCKS_APART = 5  # blocks: nearer ones share their window
MIN_BLOCKS = 40  # of them, to correct a frame
FRAMES_KEPT = 2 * AROUND + 2  # frames
MIN_COSINE = 0.9  # cosine: cameras in one line share the direction across their sight lines


def refuse_unless_in_a_row(geometry: "GridGeometry") -> None:
    """Make sure that the pairs of cameras share the direction across their sight lines."""
    along = {}
    for pair in geometry.pairs:
        rise = parallax(geometry.rig, pair, np.mean(geometry.grid.x), np.mean(geometry.grid.y))
        along[pair] = rise / max(float(np.hypot(*rise)), 1e-12)
    (first, of_first), *others = along.items()
    for pair, direction in others:
        cosine = abs(float(direction @ of_first))
        if cosine <= MIN_COSINE:
            raise ExperimentError(
                f"`vibration: correct` is for cameras in a row: the sight lines of {'-'.join(first)} and of "
                f"{'-'.join(pair)} part in directions {np.degrees(np.arccos(cosine)):.0f} degrees apart, and "
                "which camera shakes cannot be determined; leave `vibration` out of the settings, or measure "
                "z with two cameras (`surface: {pairs: ...}`)"
            )


class Stabilizer:
    """Corrected frames of a block, and by how much each was corrected."""

    def __init__(self, frames: Mapping[str, Sequence[Image | None]], geometry: "GridGeometry") -> None:
        self.frames, self.geometry = frames, geometry
        self.shifts: dict[int, dict[str, Array]] = {}
        self._kept: dict[int, dict[str, Image | None]] = {}

    def __call__(self, position: int) -> dict[str, Image | None]:
        """Images of all cameras at a position of the block, corrected."""
        if position not in self._kept:
            raw = {name: one[position] for name, one in self.frames.items()}
            self._kept[position], self.shifts[position] = corrected(raw, self.geometry)
            while len(self._kept) > FRAMES_KEPT:
                del self._kept[next(iter(self._kept))]
        return self._kept[position]


class StabilizedFrames(Sequence[Image | None]):
    """Corrected frames of one camera."""

    def __init__(self, stabilizer: Stabilizer, name: str) -> None:
        self._stabilizer, self._name = stabilizer, name

    def __len__(self) -> int:
        return len(self._stabilizer.frames[self._name])

    def __getitem__(self, position: Any) -> Any:
        return self._stabilizer(position)[self._name]


def corrected(
    images: Mapping[str, Image | None], geometry: "GridGeometry"
) -> tuple[dict[str, Image | None], dict[str, Array]]:
    """Images of one moment turned back, and by how much, as from `shifts`."""
    found = shifts(images, geometry)
    out: dict[str, Image | None] = dict(images)
    for name, low in found.items():
        image = images[name]
        if image is not None:
            out[name] = moved(image, low, name, geometry)
    return out, found


def prepared(
    images: Mapping[str, Image | None], geometry: "GridGeometry", widths: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Images of an instant, ready for matching between cameras; those that cannot be used are left out.
    The widths of their beads, px, are found where they are not given.
    """
    from wavefield.measurement.images import prepare, ready, usable

    out = {}
    for name in geometry.surface_cameras:
        image = images.get(name)
        if image is not None and usable(image, geometry.rig[name].size):
            flat = ready(image, geometry.sights[name].binning, widths[name] if widths else None)
            out[name] = prepare(flat, name, geometry)
    return out


def shifts(images: Mapping[str, Image | None], geometry: "GridGeometry") -> dict[str, Array]:
    """By how much each camera's picture has moved across the sight lines, in one frame.
    (3,), px on the water: in the middle of the lattice, and what is added at its right and upper edge.
    """
    from wavefield.measurement.pair import match_pair

    flat = prepared(images, geometry)
    if len(flat) < len(geometry.surface_cameras):
        return {}
    found: dict[str, Array] = {geometry.reference: np.zeros(3)}
    normals: list[Array] = []
    cells = np.s_[::BLOCKS_APART, ::BLOCKS_APART]
    design = np.stack([part[cells] for part in _scaled(geometry)], axis=-1)
    for a, b in geometry.pairs:
        match = match_pair(flat[a], flat[b], (a, b), geometry)
        low = _fit(design[match.matched[cells]], match.eps_y[cells][match.matched[cells]] / geometry.pixel)
        if low is None:
            return {}
        normals.append(_across(match.parallax))
        cosine = float(normals[-1] @ normals[0])
        if not abs(cosine) > MIN_COSINE:
            return {}  # cameras that are not in one line: which one moved is not a matter of signs
        found[b] = np.sign(cosine) * low
    usual = np.median(list(found.values()), axis=0)
    return {name: low - usual for name, low in found.items()}


def _scaled(geometry: "GridGeometry") -> tuple[Array, Array, Array]:
    """1, and places on the lattice from -1 to 1 along x and y."""
    x, y = np.meshgrid(*(np.linspace(-1.0, 1.0, len(v)) for v in (geometry.lattice.x, geometry.lattice.y)))
    return np.ones_like(x), x, y


def _fit(design: Array, values: Array) -> Array | None:
    def huber(residual: Array) -> Array:
        miss = np.abs(residual)
        bound = 2.0 * (PER_MEDIAN * np.median(miss) + 1e-9)
        return np.asarray(np.sqrt(np.minimum(1.0, bound / np.maximum(miss, 1e-12))))

    if len(values) < MIN_BLOCKS:
        return None
    return reweighted_lstsq(design, values, np.ones(len(values)), huber, 6)[0]


def _across(parallax: Array) -> Array:
    """Mean unit vector across the sight lines of a pair, (2,)."""
    along = np.nanmean(parallax.reshape(2, -1), axis=1)
    along = along / max(float(np.hypot(*along)), 1e-12)
    return np.array([along[1], -along[0]])


def moved(image: Image, low: Array, name: str, geometry: "GridGeometry") -> NDArray[np.float32]:
    """A raw image (row, column) moved back by what its camera has moved, `low` (3,) as from `shifts`."""
    x, y = (v[::8, ::8].ravel() for v in np.meshgrid(geometry.lattice.x, geometry.lattice.y))
    design = np.stack([part[::8, ::8].ravel() for part in _scaled(geometry)], axis=-1)
    along = parallax(geometry.rig, geometry.pairs[0], x, y)
    along /= np.maximum(np.hypot(*along), 1e-12)
    # eps_y is the part of x_b - x_a along (dD_y, -dD_x) / |dD|, and dD = D_b - D_a points against `along`
    size = -(design @ low) * geometry.pixel
    dx, dy = -along[1] * size, along[0] * size
    camera = geometry.rig[name]
    before = np.stack(camera.project(x, y, 0.0), axis=-1)
    after = np.stack(camera.project(x + dx, y + dy, 0.0), axis=-1)
    A = np.column_stack([before, np.ones(len(before))])
    affine = np.linalg.lstsq(A, after - before, rcond=None)[0].T + np.eye(2, 3)
    size_px = (image.shape[1], image.shape[0])
    flat = np.ascontiguousarray(image, np.float32)
    out = cv2.warpAffine(flat, affine, size_px, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    return np.maximum(np.asarray(out, np.float32), 0)
