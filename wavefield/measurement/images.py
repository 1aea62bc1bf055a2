"""Prepare frames for matching: remove the background, compress the brightness, bin, rectify, mask."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.compiled import compiled
from wavefield.images import fill_masked
from wavefield.matching.prepared import NOISE_BLUR_PX, Mask
from wavefield.measurement.geometry import Covered, GridGeometry, Pixels
from wavefield.measurement.rectify import bin_pixels, rectify, widen

SURROUNDINGS_SIGMA_PX = 4.0  # standard deviation of the Gaussian mean around a bead
BEAD_WIDTHS_PX = 1.5, 8.0  # narrowest and widest bead, at half height
MIN_SKEWNESS = 0.3  # least skewness of the brightness of beads; below, the image shows a texture
MAX_SIZE_TO_WIDTH = 3.0  # objects wider than this many bead widths belong to the background


def bead_width(image: NDArray[Any]) -> float:
    """Return the width at half height of beads in an image, px, from the autocorrelation; 0 for a texture.

    White noise affects the correlation at zero shift only, so shifts r of 1 and 2 px are used: for Gaussian
    beads of standard deviation s, the correlation is exp(-r^2 / 4 s^2). The local mean (sigma 4 px) is
    subtracted first, which also removes a part of each bead: widths of 2 to 7 px come out a tenth to a third
    too small. An image is a texture (water without beads) if its brightness is not skewed.
    """
    part = np.ascontiguousarray(image, np.float32)
    around = cv2.GaussianBlur(part, (0, 0), SURROUNDINGS_SIGMA_PX)
    if _skewness(cv2.GaussianBlur(part, (0, 0), NOISE_BLUR_PX) - around) < MIN_SKEWNESS:
        return 0.0
    part = part - around
    part = np.clip(part, *np.percentile(part[::4, ::4], (1, 99.5)))
    part -= part.mean()
    one, two = (
        0.5 * float((part[:, k:] * part[:, :-k]).mean() + (part[k:] * part[:-k]).mean()) for k in (1, 2)
    )
    if one <= 0:
        return BEAD_WIDTHS_PX[0]
    fall = max(np.log(one / max(two, 1e-6 * one)) / 3.0, 0.02)  # 1 / 4 s^2
    return float(np.clip(np.sqrt(8 * np.log(2.0)) * np.sqrt(0.25 / fall), *BEAD_WIDTHS_PX))


def _skewness(part: NDArray[Any]) -> float:
    """Return the skewness of the brightness of every second pixel along x and y."""
    some = part[::2, ::2]
    some = some[np.isfinite(some)].astype(np.float64)
    if not some.size:
        return 0.0
    some -= some.mean()
    return float(np.mean(some**3) / max(np.mean(some**2) ** 1.5, 1e-30))


def above_floor(image: NDArray[Any], width: float) -> NDArray[Any]:
    """Remove objects wider than three bead widths (`width`, px) by a white top-hat; not if `width` is 0."""
    if not width:
        return image
    side = int(np.ceil(MAX_SIZE_TO_WIDTH * width)) // 2 * 2 + 3
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        image = image.astype(np.float32)
    return np.asarray(cv2.morphologyEx(np.ascontiguousarray(image), cv2.MORPH_TOPHAT, kernel))


KNEE_TO_CONTRAST = 0.5  # brightness, over the contrast, at which the compression becomes logarithmic
LEVEL_QUANTILES = 0.01, 0.5, 0.99  # of the brightness: background, median, bright beads
BETWEEN_CAMERAS, IN_TIME = 1.5, 0.6  # amounts for `sharpened` in matching between cameras, and in time
GREY_LEVELS_PER_E = 5000.0  # grey levels per factor e of brightness: 65535 levels suffice for 16-bit images


def usable(image: NDArray[Any] | None, size: tuple[int, int]) -> bool:
    """Return whether a frame is a grey image of `size` (width, height) with contrast and not mostly NaN."""
    if image is None or np.ndim(image) != 2 or image.shape != (size[1], size[0]):
        return False
    if image.dtype.kind not in "uif":
        return False
    low, _, high = _levels(image)
    return high > low


def ready(
    image: NDArray[Any], count: int, width: float | None = None, covered: NDArray[np.bool_] | None = None
) -> NDArray[Any]:
    """Prepare a usable frame (h, w): remove its background, compress its brightness, bin count x count px.
    `width` is the width of the beads, px, 0 for a texture (no beads), or None to measure it. Pixels where
    `covered` (h, w) is True are ignored."""
    if covered is not None:
        image = fill_masked(image, covered)
    width = bead_width(image) if width is None else width
    if width:
        image = above_floor(image, width)
        low, half, _ = _levels(image, covered)
        # beads are much brighter than the median; a black level above it suppresses noise and grains of a
        # floor
        return bin_pixels(log_compress(image, half + (half - low), covered), count)
    return bin_pixels(log_compress(image, covered=covered), count)


def sharpened(image: NDArray[Any], amount: float) -> NDArray[np.float32]:
    """Return the image sharpened, so that overlapping beads bias matches less; `amount` 0: unchanged."""
    kernel = np.array([-amount, 1.0 + 2.0 * amount, -amount], np.float32)
    part = np.ascontiguousarray(image, np.float32)
    return np.asarray(cv2.sepFilter2D(part, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REPLICATE))


def log_compress(
    image: NDArray[Any], black: float | None = None, covered: NDArray[np.bool_] | None = None
) -> NDArray[Any]:
    """Compress brightness I to 5000 log(1 + (I - B) / (0.5 (I_99 - B))), and to 0 where I < B.
    I_99 is the 99 % quantile of pixels that are not `covered`; B is `black`, by default the 1 % quantile. A
    factor on the brightness becomes a constant that is added."""
    low, _, high = _levels(image, covered)
    low = low if black is None else black
    knee = max(KNEE_TO_CONTRAST * (high - low), 1e-6 * max(abs(low), abs(high), 1e-30))
    if image.dtype in (np.uint8, np.uint16):
        grey = np.arange(256 if image.dtype == np.uint8 else 65536, dtype=np.float64)
        table = np.rint(GREY_LEVELS_PER_E * np.log1p(np.maximum(grey - low, 0.0) / knee))
        table = np.minimum(table, 65535.0).astype(np.uint16)
        image = np.ascontiguousarray(image)
        if image.dtype == np.uint8:
            return cv2.LUT(image, table)
        out = np.empty(image.shape, np.uint16)
        _table_value(image, table, out)
        return out
    above = np.maximum(image.astype(np.float32) - np.float32(low), np.float32(0.0))
    result: NDArray[Any] = np.float32(GREY_LEVELS_PER_E) * np.log(np.float32(1.0) + above / np.float32(knee))
    return result


@compiled()
def _table_value(image: NDArray[Any], table: NDArray[Any], out: NDArray[Any]) -> None:
    """Look up each pixel of a 16-bit image in `table`, and write the entries to `out`."""
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            out[y, x] = table[image[y, x]]


def _levels(image: NDArray[Any], covered: NDArray[np.bool_] | None = None) -> tuple[float, float, float]:
    """Return a tuple: the 1, 50 and 99 % quantiles of the brightness of every eighth pixel along x and y.
    Pixels in `covered` do not count. All are 0 if no pixel is left or fewer than about half are finite."""
    sample = image[3::8, 3::8].ravel()
    if covered is not None:
        sample = sample[~covered[3::8, 3::8].ravel()]
    if image.dtype in (np.uint8, np.uint16):
        counts = np.bincount(sample)  # much faster than sorting
        grey = np.flatnonzero(counts)
        counts = counts[grey]
    else:
        sample = sample.astype(np.float32)
        sample = sample[np.isfinite(sample)]
        if 2 * sample.size < image.size // 64:
            return 0.0, 0.0, 0.0
        grey, counts = np.unique(sample, return_counts=True)
    if not sample.size:
        return 0.0, 0.0, 0.0
    # interpolate between grey levels: in dark 8-bit images, whole levels would jump from frame to frame
    rank = np.cumsum(counts) - 0.5 * counts
    low, half, high = np.interp(sample.size * np.array(LEVEL_QUANTILES), rank, grey)
    return float(low), float(half), float(high)


Masks = Mapping[str, Pixels | None]


def covered_in(masks: Masks, geometry: GridGeometry) -> dict[str, Covered]:
    """Return the masks of one frame, by camera, prepared for matching; True marks pixels to ignore.
    Results are kept in `geometry` and used again while the mask of a camera is the same array."""
    out = {}
    for name in geometry.cameras:
        pixels = masks.get(name)
        if pixels is None:
            continue
        last = geometry.prepared_masks.get(name)
        if last is None or last[0] is not pixels:
            last = geometry.prepared_masks[name] = pixels, _ready(pixels, name, geometry)
        out[name] = last[1]
    return out


def _ready(pixels: Pixels, name: str, geometry: GridGeometry) -> Covered:
    """Prepare a mask (h, w), True on pixels to ignore, for matching camera `name` in time and with others."""
    w, h = geometry.sights[name].camera.size
    count = geometry.sights[name].binning
    good = np.where(pixels[: h * count, : w * count], np.uint8(0), np.uint8(255))
    good = cv2.resize(good, (w, h), interpolation=cv2.INTER_AREA) if count > 1 else good
    flat = None
    if name in geometry.views:
        X, Y = (np.float32(0.5) * place for place in geometry.views[name].maps)
        seen = cv2.remap(good, X, Y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        flat = Mask.of(geometry.views[name].visible & (seen > 250), geometry.settings.stereo)
    return Covered(Mask.of(good > 250, geometry.settings.piv), flat)


def masked_nodes(
    covered: tuple[Mapping[str, Covered], Mapping[str, Covered]],
    missing: frozenset[str],
    z: NDArray[Any],
    geometry: GridGeometry,
) -> Pixels:
    """Return a mask (ny, nx), True for nodes hidden by outlines or by the image masks `covered`.
    `covered` are the masks of the first and second frame, by camera. They hide a node at z (ny, nx), metres,
    if they leave no pair for z or fewer than two cameras for velocity. Cameras in `missing` do not count."""
    hidden = {}
    for name in {*covered[0], *covered[1]}:
        X, Y = geometry.sights[name].position(z)
        hidden[name] = np.any([one[name].at(X, Y) for one in covered if name in one], axis=0)
    nowhere = np.zeros(z.shape, bool)
    present = [name for name in geometry.cameras if name not in missing]
    pairs = geometry.pairs_for([n for n in geometry.surface_cameras if n in present])
    no_pair = np.all([hidden.get(a, nowhere) | hidden.get(b, nowhere) for a, b in pairs], axis=0)
    velocity = [name for name in geometry.velocity_cameras if name in present]
    seeing = np.sum([~hidden.get(name, nowhere) for name in velocity], axis=0)
    return np.asarray(geometry.covered_nodes | no_pair | (seeing < 2))


def prepare(
    image: NDArray[Any], camera: str, geometry: GridGeometry, mask: Mask | None = None
) -> matching.PreparedImage:
    """Sharpen and rectify an image from `ready`, and prepare it for matching between cameras.
    `mask` is for the rectified image; None uses all pixels that the camera sees."""
    view = geometry.views[camera]
    flat = widen(rectify(sharpened(image, BETWEEN_CAMERAS), *view.maps), *view.blur)
    return matching.prepare(flat, geometry.settings.stereo, mask=mask or view.mask)


Frames = Mapping[str, NDArray[Any] | None]


@dataclass(frozen=True)
class Images:
    """Usable images at one time, by camera, prepared by `ready`, and the masks of the cameras."""

    ready: Mapping[str, NDArray[Any]]
    covered: Mapping[str, Covered]
    geometry: GridGeometry

    @property
    def missing(self) -> frozenset[str]:
        """Names of the cameras without a usable frame."""
        return frozenset(name for name in self.geometry.cameras if name not in self.ready)

    def rectified(self, left_out: str | None = None) -> dict[str, matching.PreparedImage]:
        """Return, by camera, the images rectified and prepared for matching between cameras.
        The camera `left_out` is excluded. The result is empty for a light sheet, where z is known."""
        if self.geometry.z_is_known:
            return {}
        return {
            name: prepare(
                self.ready[name],
                name,
                self.geometry,
                self.covered[name].flat if name in self.covered else None,
            )
            for name in self.geometry.surface_cameras
            if name in self.ready and name != left_out
        }

    def in_time(self) -> dict[str, matching.PreparedImage]:
        """Return, by camera, the images prepared for matching with the next frame, not rectified."""
        return {
            name: matching.prepare(
                sharpened(self.ready[name], IN_TIME),
                self.geometry.settings.piv,
                self.covered[name].raw if name in self.covered else None,
            )
            for name in self.geometry.velocity_cameras
            if name in self.ready
        }


def images_of(
    frames: Frames, geometry: GridGeometry, beads: Mapping[str, float], masks: Masks | None = None
) -> Images:
    """Prepare the usable images at one time, and the masks of the cameras.
    `beads` are bead widths, raw px, and `masks` (h, w) are True on pixels to ignore, by camera."""
    masks = masks or {}
    found: dict[str, NDArray[Any]] = {}
    for name in geometry.cameras:
        image = frames.get(name)
        if image is not None and usable(image, geometry.rig[name].size):
            found[name] = ready(image, geometry.sights[name].binning, beads[name], masks.get(name))
    return Images(found, covered_in(masks, geometry), geometry)
