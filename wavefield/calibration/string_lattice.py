"""The lattice of a grid of bright strings, grown from seeds whose two vectors run along strings."""

import cv2
import numpy as np
from scipy.spatial import cKDTree

from wavefield.calibration.points import Image
from wavefield.calibration.target_lattice import (
    REACH,
    Candidates,
    TargetLattice,
    cross,
    crossings,
    independent_pair,
)
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

SCALES = (1.5, 2.5, 4.0)  # px; a string may be under 2 px wide in one camera and 4 px in another
MIN_CROSSINGS = 12
MAX_SEEDS = 12  # per scale
MIN_SEED_LIGHT = 0.35  # along a seed's vectors, relative to the light of the crossings
NO_GRID = (
    "no grid of white strings was found in the image; it needs a dark ground, and strings in focus that "
    "are brighter than it"
)


def best_lattice(image: Image) -> tuple[TargetLattice, float]:
    """The lattice whose meshes run along the most light, and the scale of its candidates."""
    best: TargetLattice | None = None
    best_scale, most = SCALES[0], 0.0
    for scale in SCALES:
        candidates = crossings(image, scale)
        if len(candidates.pixel) < MIN_CROSSINGS:
            continue
        for start, e1, e2 in _seeds(image, candidates):
            lattice = TargetLattice(start, e1, e2)
            lattice.grow(candidates, image.shape[::-1])
            if len(lattice) < MIN_CROSSINGS:
                continue
            light = _light_along(image, lattice)
            if light > 1.03 * most:
                best, best_scale, most = lattice, scale, light
            if len(lattice) > 0.6 * candidates.strong.sum():
                break
    if best is None:
        raise CalibrationError(NO_GRID)
    return best, best_scale


def _light_along(image: Image, lattice: TargetLattice) -> float:
    """Light on the lines between neighbouring nodes in excess of that next to them, summed over their length.
    A lattice that noise or dirt suggests has many nodes, but no strings between them.
    """
    place, filled = lattice.place, lattice.filled
    along = np.linspace(0.25, 0.75, 16)[None, :, None]
    total = 0.0
    for axis in (0, 1):
        first = np.argwhere(filled & np.roll(filled, -1, axis))
        start = place[tuple(first.T)]
        vector = place[tuple((first + np.eye(2, dtype=int)[axis]).T)] - start
        aside = 0.22 * lattice.predict(first - REACH)[1][:, 1 - axis][:, None]
        line = start[:, None] + along * vector[:, None]
        on, off = sample(image, line), (sample(image, line + aside) + sample(image, line - aside)) / 2
        total += float(((on - off).mean(1) * np.hypot(*vector.T)).sum())
    return total


def _seeds(image: Image, candidates: Candidates) -> list[tuple[Array, Array, Array]]:
    """Crossings near the middle with two neighbours each along a string: (start, e1, e2), right-handed."""
    height, width = image.shape
    light = _above_ground(image, candidates.scale)
    pixel = candidates.pixel[candidates.strong]
    if len(pixel) < MIN_CROSSINGS:
        return []
    bright = np.median(sample(light, pixel))
    tree = cKDTree(pixel)
    along = np.linspace(0.2, 0.8, 22)[None, :, None]
    seeds: list[tuple[Array, Array, Array]] = []
    for k in np.argsort(np.hypot(*(pixel - [width / 2, height / 2]).T))[:120:3]:
        _, near = tree.query(pixel[k], min(13, len(pixel)))
        arms = pixel[near[1:]] - pixel[k]
        arms = arms[np.hypot(*arms.T) > 4 * candidates.scale]
        if len(arms):
            lit = sample(light, pixel[k] + along * arms[:, None])
            arms = arms[np.percentile(lit, 15, axis=1) > MIN_SEED_LIGHT * bright]
        pair = independent_pair(arms)
        if pair is not None:
            # rows run downwards in an image, therefore the cross product of a right-handed pair is negative
            e1, e2 = pair if cross(*pair) < 0 else pair[::-1]
            seeds.append((pixel[k], e1, e2))
        if len(seeds) == MAX_SEEDS:
            break
    return seeds


def _above_ground(image: Image, scale: float) -> Image:
    """The image smoothed, less its local ground."""
    smooth = cv2.GaussianBlur(image, (0, 0), max(1.0, 0.5 * scale))
    ground = cv2.blur(cv2.erode(smooth, np.ones((15, 15), np.uint8)), (31, 31))
    return np.asarray(smooth, np.float32) - np.asarray(ground, np.float32)


def sample(image: Image, pixel: Array) -> Image:
    """Bilinear values at pixel positions (..., 2); those outside take the nearest pixel's value."""
    flat = pixel.reshape(-1, 2).astype(np.float32)
    rows = 30000  # cv2.remap takes no more than 32767 rows
    parts = [
        cv2.remap(image, part[:, :1], part[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in np.split(flat, range(rows, len(flat), rows))
    ]
    return np.asarray(np.concatenate(parts), np.float32).reshape(pixel.shape[:-1])
