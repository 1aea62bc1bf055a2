"""Compare the cameras' images by matching patches, independently of the measurement.

Patches of the images are laid on the plane of the water at rest and compared by normalised correlation, every
camera with every other and with itself a frame later. A point at height z appears displaced along the
parallax of the two cameras; what is displaced across it (eps_y) cannot be water, whatever its shape.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.grid import Grid
from wavefield.matching.patch_shifts import locate
from wavefield.rig import Rig
from wavefield.rig.field import pixel_size
from wavefield.rig.stereo import parallax

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Read = Callable[[str, int], NDArray[np.generic] | None]  # of camera and frame
Pair = tuple[str, str]

SIDE = 32  # px of a patch
REACH = 40  # px: search radius of a patch
WHOLE = SIDE + 2 * REACH
MAX_PATCHES = 120
Plane = tuple[float, float, float]  # height of a patch's middle, m, and slopes along x and y
STILL: Plane = (0.0, 0.0, 0.0)
KNOTS = 15  # along either side, at which tilted patches are projected
MIN_CORRELATION = 0.5  # of patches that show the same water
FLIPS: dict[str, tuple[slice, ...]] = {
    "mirrored": np.s_[:, ::-1],
    "upside down": np.s_[::-1, :],
    "turned by 180 degrees": np.s_[::-1, ::-1],
}
MAX_DEPARTURE = 1.5  # px of eps_y from its smooth part


@dataclass(frozen=True)
class Comparison:
    """One camera's patches found again in another's images."""

    moved: Array  # (n, 2): By how much along x and y, px on the water; NaN where not found
    peak_correlation: Array  # (n,): Normalised correlation


@dataclass
class PatchMatcher:
    """Patches of all cameras on the plane of still water, sampled on demand."""

    read: Read  # From camera and frame to the image, or None
    rig: Rig  # The cameras
    grid: Grid  # Area that is compared
    planes: Sequence[Plane] = (STILL,)  # On which patches are laid: each counts where it is most alike
    most: int = MAX_PATCHES

    def __post_init__(self) -> None:
        self.pixel = float(pixel_size(self.rig, self.grid))
        self.x, self.y = self._places()
        self._maps: dict[str, tuple[Image, Image]] = {}
        self._patches: dict[tuple[str, int, str, str], Image | None] = {}

    def _places(self) -> tuple[Array, Array]:
        """Middles of the patches: spread over what all cameras see."""
        pitch = SIDE * self.pixel
        limits = (self.grid.x, self.grid.y)
        x, y = (np.arange(low + pitch / 2, high - pitch / 2 + 1e-9, pitch) for low, high in limits)
        X, Y = (v.ravel() for v in np.meshgrid(x, y))
        visible = np.ones(X.shape, bool)
        for camera in self.rig.cameras.values():
            for a, b in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
                visible &= camera.sees(X + a * pitch, Y + b * pitch, 0.0)
        chosen = np.flatnonzero(visible)
        chosen = chosen[np.linspace(0, max(len(chosen) - 1, 0), min(self.most, len(chosen))).astype(int)]
        return X[chosen], Y[chosen]

    def _map(self, name: str, plane: Plane = STILL) -> tuple[Image, Image]:
        if plane == STILL and name in self._maps:
            return self._maps[name]
        offset = np.arange(WHOLE) - (WHOLE - 1) / 2
        knots = offset if plane == STILL else np.linspace(offset[0], offset[-1], KNOTS)
        x, y = knots * self.pixel, knots[:, None] * self.pixel
        level, along_x, along_y = plane
        places = self.x[:, None, None] + x, self.y[:, None, None] + y, level + along_x * x + along_y * y
        parts = np.stack(self.rig[name].project(*places))
        if plane != STILL:
            between = np.stack([np.interp(offset, knots, one) for one in np.eye(KNOTS)], axis=1)
            parts = between @ parts @ between.T
        column, row = parts.reshape(2, -1, WHOLE).astype(np.float32)
        if plane == STILL:
            self._maps[name] = column, row
        return column, row

    def patches(self, name: str, frame: int, change: str = "", through: str = "") -> Image | None:
        """Patches of one image with their surroundings, (n, WHOLE, WHOLE) grey levels.
        The image may be flipped (`change`) and taken `through` the lens of another camera.
        """
        key = (name, frame, change, through)
        if key not in self._patches:
            self._patches[key] = self.sampled(name, frame, change, through)
        return self._patches[key]

    def sampled(
        self, name: str, frame: int, change: str = "", through: str = "", plane: Plane = STILL
    ) -> Image | None:
        """The same on any plane, not kept."""
        image = self.read(name, frame)
        if image is not None and change:
            image = np.asarray(image)[FLIPS[change]]
        return _sampled(image, *self._map(through or name, plane), WHOLE)

    def around(self, name: str, frame: int, near: NDArray[np.int64], reach: int) -> Image | None:
        """Surroundings (n, SIDE + 2 reach, SIDE + 2 reach) of places `near` (n, 2), px, from the patches."""
        image = self.read(name, frame)
        if image is None or len(near) == 0:
            return None
        side = SIDE + 2 * reach
        column, row = (part.reshape(-1, WHOLE, WHOLE) for part in self._map(name))
        cuts = [np.s_[k, y : y + side, x : x + side] for k, (x, y) in enumerate(near + REACH - reach)]
        column, row = (np.concatenate([part[cut] for cut in cuts]) for part in (column, row))
        return _sampled(image, column, row, side)

    def contrast(self, name: str, frame: int) -> Array | None:
        """Standard deviation of each patch, grey levels."""
        patches = self.patches(name, frame)
        return None if patches is None else np.nan_to_num(middle(patches).std(axis=(1, 2)).astype(float))

    def across(self, pair: Pair) -> tuple[Array, Array]:
        """Unit vectors along and across the parallax of two cameras, each (n, 2)."""
        along = self._rise(pair)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        return along, np.stack([-along[:, 1], along[:, 0]], axis=-1)

    def parallax(self, pair: Pair) -> Array:
        """Displacement from one camera to the other per height, (n,)."""
        return np.asarray(np.maximum(np.linalg.norm(self._rise(pair), axis=1), 1e-12))

    def on_still_water(self, found: Comparison | None, pair: Pair, plane: Plane) -> Comparison | None:
        """What was found on a plane as it would be displaced on that of still water."""
        if found is None or plane == STILL:
            return found
        level, *slopes = plane
        sight = np.transpose(self.rig[pair[1]].sight_line(self.x, self.y))
        moved = found.moved - sight * (found.moved @ slopes)[:, None]
        return Comparison(moved + self._rise(pair) * level / self.pixel, found.peak_correlation)

    def _rise(self, pair: Pair) -> Array:
        return parallax(self.rig, pair, self.x, self.y).T


def _sampled(image: NDArray[np.generic] | None, column: Image, row: Image, side: int) -> Image | None:
    """Squares (n, side, side) of an image at pixels (n side, side); NaN outside of it."""
    if image is None:
        return None
    flat = np.ascontiguousarray(image, np.float32)
    # real numbers, which often are from 0 to 1, are scaled to 255, as other grey levels
    largest = float(np.abs(flat).max()) if image.dtype.kind == "f" else 0.0
    if largest > 0:
        flat = flat * np.float32(255.0 / largest)
    sampled = cv2.remap(flat, column, row, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, np.nan)
    return np.asarray(sampled, np.float32).reshape(-1, side, side)


def middle(patches: Image) -> Image:
    """The patches (n, SIDE, SIDE) without their surroundings."""
    reach = (patches.shape[1] - SIDE) // 2
    return patches[:, reach : reach + SIDE, reach : reach + SIDE]


def compare(
    first: Image | None, second: Image | None, near: NDArray[np.int64] | None = None
) -> Comparison | None:
    """Find the middle of each patch in another, (n, SIDE + 2 reach, SIDE + 2 reach), sampled `near` px."""
    if first is None or second is None:
        return None
    moved = np.full((len(first), 2), np.nan)
    peak_correlation = np.zeros(len(first))
    reach = (second.shape[1] - SIDE) // 2
    templates = np.ascontiguousarray(middle(first))
    usual = templates.mean(axis=(1, 2))
    sound = templates.std(axis=(1, 2)) >= 1e-3  # not where something is NaN
    for k in np.flatnonzero(sound).tolist():
        around = np.ascontiguousarray(second[k])
        gaps = np.isnan(around)
        if gaps.any():
            around = np.where(gaps, usual[k], around)
        column, row, peak_correlation[k] = locate(templates[k], around)
        moved[k] = column - reach, row - reach
    return Comparison(moved if near is None else moved + near, peak_correlation)


def most_alike(found: Sequence[Comparison | None]) -> Comparison | None:
    """Of several comparisons of the same patches that of the highest correlation, patch by patch."""
    some = [one for one in found if one is not None]
    if len(some) < 2:
        return some[0] if some else None
    moved, peaks = (np.stack([getattr(one, name) for one in some]) for name in ("moved", "peak_correlation"))
    best, each = peaks.argmax(axis=0), np.arange(peaks.shape[1])
    return Comparison(moved[best, each], peaks[best, each])


@dataclass(frozen=True)
class PairConsistency:
    """How two cameras agree."""

    fraction: float  # Patches found again, and across the parallax where a smooth eps_y lets expect them
    eps_y: Array  # (m,): Of those, px on the water
    smooth: Array  # (3,): Its smooth part: px, px per half width along x, along y
    places: NDArray[np.intp]  # (m,): Which patches
    # (m,): Of those, m: by what they are displaced along the parallax
    height: Array = field(default_factory=lambda: np.zeros(0))


def agreement(
    patch_matcher: PatchMatcher, pair: Pair, found: Comparison | None, ground: NDArray[np.bool_] | None = None
) -> PairConsistency:
    """How far one camera's patches found in another's could be the same water; of the patches in `ground`."""
    n = len(patch_matcher.x)
    nothing = PairConsistency(0.0, np.zeros(0), np.zeros(3), np.zeros(0, np.intp))
    counted = n if ground is None else int(ground.sum())
    if found is None or counted < 4:
        return nothing
    along, across = patch_matcher.across(pair)
    eps_y = (found.moved * across).sum(axis=1)
    height = (found.moved * along).sum(axis=1) * patch_matcher.pixel / patch_matcher.parallax(pair)
    good = (found.peak_correlation > MIN_CORRELATION) & np.isfinite(eps_y)
    if ground is not None:
        good &= ground
    if good.sum() < 4:
        return nothing
    design = np.stack([np.ones(n), *(scaled(v) for v in (patch_matcher.x, patch_matcher.y))], axis=-1)
    smooth = np.array([np.median(eps_y[good]), 0.0, 0.0])
    for _ in range(4):  # refit the smooth part to what is near it
        near = good & (np.abs(eps_y - design @ smooth) < MAX_DEPARTURE)
        if near.sum() < 8:
            break
        smooth = np.linalg.lstsq(design[near], eps_y[near], rcond=None)[0]
    near = good & (np.abs(eps_y - design @ smooth) < MAX_DEPARTURE)
    return PairConsistency(
        float(near.sum() / counted), eps_y[near], smooth, np.flatnonzero(near), height[near]
    )


def scaled(v: Array) -> Array:
    """Coordinates scaled to -1 to 1."""
    return np.asarray((v - v.mean()) / max(float(np.ptp(v)) / 2, 1e-12))


def rms_over_field(smooth: Array) -> float:
    """Rms over the field of an eps_y that is constant and linear along x and y, (3,)."""
    return float(np.sqrt(smooth[0] ** 2 + (smooth[1] ** 2 + smooth[2] ** 2) / 3))


def grounds(patch_matcher: PatchMatcher, frame: int, names: Sequence[str]) -> Mapping[str, NDArray[np.bool_]]:
    """Patches (n,) in which each camera shows something: contrast of a fifth of its median at least."""
    out = {}
    for name in names:
        contrast = patch_matcher.contrast(name, frame)
        if contrast is not None and len(contrast):
            usual = np.median(contrast[contrast > 0.5]) if (contrast > 0.5).any() else np.inf
            out[name] = contrast > 0.2 * usual
        else:
            out[name] = np.zeros(len(patch_matcher.x), bool)
    return out
