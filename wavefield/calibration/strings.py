"""Find a grid of white strings: its crossings, their indices, and the two discs that mark the axes.

A node is a crossing with indices (i, j). The larger disc marks node (0, 0), the smaller one node (1, 0). A
lattice is a set of nodes with their pixels.
"""

import cv2
import numpy as np
from scipy.spatial import cKDTree

from wavefield.calibration.lattice import (
    MAX_SEEDS,
    REACH,
    WINDOW,
    Candidates,
    SmoothMap,
    TargetLattice,
    around,
    cross,
    crossings,
    independent_pair,
)
from wavefield.calibration.observations import LIMITS
from wavefield.calibration.points import Image, Mask, Nodes, TargetPoints
from wavefield.calibration.string_crossings import WIDTH1, WIDTH2, Crossings, fit_crossings, start_parameters
from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

SCALES = (1.5, 2.5, 4.0)  # px, of the smoothing; strings are from less than 2 px to 4 px wide
MIN_SEED_LIGHT = 0.35  # brightness between a seed and its neighbours, relative to that of the crossings
NO_GRID = (
    "no grid of white strings was found in the image; it needs a dark ground, and strings in focus that "
    "are brighter than it"
)


def best_lattice(image: Image) -> tuple[TargetLattice, float]:
    """Return the grid of crossings with the brightest lines, and the smoothing (standard deviation), px.
    Raises a CalibrationError if no grid is found."""
    best: TargetLattice | None = None
    best_scale, most = SCALES[0], 0.0
    for scale in SCALES:
        candidates = crossings(image, scale)
        if len(candidates.pixel) < LIMITS.min_nodes:
            continue
        for start, e1, e2 in _seeds(image, candidates):
            lattice = TargetLattice(start, e1, e2)
            lattice.grow(candidates, image.shape[::-1])
            if len(lattice) < LIMITS.min_nodes:
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
    """Return the sum of excess brightness times length over lines between neighbouring nodes, grey px.
    The excess is the brightness on a line minus the mean brightness beside it."""
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
    """Return crossings (2,) near the image's centre, each with steps e1, e2 (2,) to two neighbours, px."""
    height, width = image.shape
    light = _above_ground(image, candidates.scale)
    pixel = candidates.pixel[candidates.strong]
    if len(pixel) < LIMITS.min_nodes:
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
            # image rows run downwards, so the cross product of a right-handed pair is negative
            e1, e2 = pair if cross(*pair) < 0 else pair[::-1]
            seeds.append((pixel[k], e1, e2))
        if len(seeds) == MAX_SEEDS:
            break
    return seeds


def _above_ground(image: Image, scale: float) -> Image:
    """Return the smoothed image (Gaussian of std `scale` / 2, at least 1 px) minus its local background."""
    smooth = cv2.GaussianBlur(image, (0, 0), max(1.0, 0.5 * scale))
    ground = cv2.blur(cv2.erode(smooth, np.ones((15, 15), np.uint8)), (31, 31))
    return np.asarray(smooth, np.float32) - np.asarray(ground, np.float32)


def sample(image: Image, pixel: Array) -> Image:
    """Interpolate the image at positions (..., 2), px; outside it, take the value of the nearest pixel."""
    flat = pixel.reshape(-1, 2).astype(np.float32)
    rows = 30000  # cv2.remap takes no more than 32767 rows
    parts = [
        cv2.remap(image, part[:, :1], part[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in np.split(flat, range(rows, len(flat), rows))
    ]
    return np.asarray(np.concatenate(parts), np.float32).reshape(pixel.shape[:-1])


FOUR_NEIGHBOURS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
CIRCLES = np.linspace(0.02, 0.45, 30)  # meshes: radii of the circles on which brightness is sampled
DISC_RADII = np.linspace(0.05, 0.38, 34)  # meshes: radii of the model discs


def numbered_from_marks(image: Image, smooth: SmoothMap, node: Nodes) -> Nodes:
    """Return the nodes (n, 2) renumbered: (0, 0) is at the larger disc and (1, 0) at the smaller disc.
    `smooth` maps the present indices `node` (n, 2) to pixels."""
    origin, step = _marks(image, smooth, node)
    rotation = np.array([[step[0], step[1]], [-step[1], step[0]]])
    out: Nodes = (node - origin) @ rotation.T
    return out


def _marks(image: Image, smooth: SmoothMap, node: Nodes) -> tuple[Nodes, Nodes]:
    """Return the node (2,) under the larger disc, and the step (2,) to the node under the smaller disc.
    `smooth` maps indices `node` (n, 2) to pixels. Raises a CalibrationError if no pair of discs is clear."""
    height, width = image.shape
    places = around(node, np.vstack([[[0, 0]], FOUR_NEIGHBOURS]))
    pixel = smooth(places)
    inside = ((pixel > 2) & (pixel < [width - 3, height - 3])).all(1)
    places, pixel = places[inside], pixel[inside]
    blurred = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7), np.float32)
    excess, usual = _circles(blurred, pixel, smooth.slopes(places))
    # if a spot of light or dirt spoils a disc, the median over directions may still find it
    median = np.median(excess, axis=2, keepdims=True), np.median(usual, axis=1, keepdims=True)
    for (on_circles, of_strings), min_quality in (((excess, usual), 0.7), (median, 1.5)):
        pairs = _pairs_of_discs(places, *_discs(on_circles, of_strings), min_quality)
        if pairs and pairs[0][0] > 1.3 * (pairs[1][0] if len(pairs) > 1 else 0.0):
            return pairs[0][1], pairs[0][2]
    raise CalibrationError(
        f"a grid of {len(node)} crossings was found, but not its marks: the larger disc on the origin "
        "and the smaller one on the next crossing along +x must both be in view, clean and without glare"
    )


def _pairs_of_discs(
    places: Nodes, quality: Array, radius: Array, grey: Array, min_quality: float
) -> list[tuple[float, Nodes, Nodes]]:
    """Return possible pairs of the two marks, best first, as (score, node, step); a high score is good.
    The node is under the larger disc; the step leads to the node under the smaller. `quality`, `radius` and
    `grey` (n,) belong to the discs fitted at the nodes `places` (n, 2)."""
    row = np.full((2 * REACH + 3, 2 * REACH + 3), -1)
    row[tuple((places + REACH + 1).T)] = np.arange(len(places))
    pairs = []
    for a in np.flatnonzero(quality > min_quality):
        for step in FOUR_NEIGHBOURS:
            b = row[tuple(places[a] + step + REACH + 1)]
            if b < 0 or quality[b] < min_quality or radius[b] > 0.9 * radius[a]:
                continue
            clearest = max(quality[a], quality[b]) > 0.5 * quality.max()
            if clearest and 0.2 < quality[b] / quality[a] < 5.0 and 0.5 < grey[b] / grey[a] < 2.0:
                score = min(quality[a], quality[b]) * min(grey[a], grey[b])
                pairs.append((score, places[a], step))
    pairs.sort(key=lambda pair: -pair[0])
    return pairs


def _circles(image: Image, pixel: Array, slopes: Array) -> tuple[Array, Array]:
    """Return brightness on circles around nodes minus its median over nodes, and this median.
    The axes are (node, circle, direction), and (circle, direction) for the median. `pixel` (n, 2) are the
    positions of the nodes, `slopes` (n, 2, 2) the steps in the image to the next nodes."""
    angle = (np.arange(32) + 0.5) * (2 * np.pi / 32)
    angle = angle[np.abs(np.sin(2 * angle)) > 0.5]
    offset = CIRCLES[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    value = sample(image, pixel[:, None, None] + offset @ slopes[:, None]).astype(float)
    value -= np.median(value[:, -10:], axis=(1, 2), keepdims=True)
    usual = np.median(value, axis=0)
    return value - usual, usual


def _discs(excess: Array, usual: Array) -> tuple[Array, Array, Array]:
    """Fit a uniform disc at each node; return quality, radius and grey value of each disc, (n,) each.
    The quality is the rms brightness that the disc explains over the rms that remains; 0 for a faint disc.
    Radii are in units of the distance between nodes. `excess` and `usual` are the results of `_circles`."""
    noise = np.median(np.abs(excess[:, -10:])) + 1e-3
    disc = np.clip((DISC_RADII[:, None] - CIRCLES) / 0.05 + 0.5, 0, 1)[..., None]
    disc = disc * np.clip(1 - usual / usual.max(), 0, 1)
    area = np.broadcast_to(np.sqrt(CIRCLES)[:, None], excess.shape[1:])
    disc = (disc * area).reshape(len(DISC_RADII), -1)
    norm = np.linalg.norm(disc, axis=1)
    white = np.inf
    for _ in range(2):
        light = (np.minimum(excess, white) * area).reshape(len(excess), -1)
        length = np.linalg.norm(light, axis=1) + 1e-9
        cosine = light @ (disc / norm[:, None]).T / length[:, None]
        best = cosine.argmax(1)
        cosine = np.clip(cosine[np.arange(len(excess)), best], 0, 0.9999)
        grey = cosine * length / norm[best]
        significant = grey > max(5 * noise, 0.3 * usual.max())
        quality = np.where(significant, cosine / np.sqrt(1 - cosine**2), 0.0)
        white = 1.2 * grey[quality.argmax()]  # limit specular spots to little more than a disc's brightness
    return quality, DISC_RADII[best], np.maximum(grey, 1e-6)


# px: trial values of the standard deviation of the blur by lens and pixel; the best one is interpolated
BLURS = np.array([0.46, 0.51, 0.56, 0.61, 0.67, 0.74, 0.83, 0.945, 1.14])
MAX_BLUR_CROSSINGS = 24  # used to find the blur, for speed


def find_strings(image: Image, target: Target) -> TargetPoints:
    """Find the crossings of white strings, with indices counted from two discs that mark the axes.
    Mirrored images are not detected. Raises a CalibrationError if strings or discs are not found."""
    lattice, scale = best_lattice(image)
    node, pixel = lattice.node, lattice.pixel
    node = numbered_from_marks(image, SmoothMap(node, pixel), node)
    fit, node, notes = _fitted(image, node, pixel, scale)
    height, width = image.shape
    return TargetPoints(node, fit.pixel, fit.std, (width, height), notes)


def _fitted(
    image: Image, node: Nodes, pixel: Array, scale: float
) -> tuple[Crossings, Nodes, tuple[str, ...]]:
    """Fit crossings at nodes, add missed ones, reject bad ones; return crossings, indices and notes.
    `scale` is the standard deviation of the smoothing with which the nodes were found, px."""
    height, width = image.shape
    smooth = SmoothMap(node, pixel)
    node = node[~_under_marks(node)]
    pixel, slopes = smooth(node), smooth.slopes(node)
    blur = float(np.median(BLURS))
    fit = fit_crossings(image, start_parameters(pixel, slopes, 0.6 * scale, blur), slopes, blur)
    good = _plausible(fit, pixel, slopes)
    if good.sum() < LIMITS.min_nodes:
        raise CalibrationError(NO_GRID)
    noise = _noise(fit, good)
    sigma = float(np.median(fit.sigma[good]))
    blur = _lens_blur(image, fit, slopes, good)
    parameters, node = fit.parameters[good], node[good]
    for _ in range(3):
        smooth = SmoothMap(node, parameters[:, :2])
        missing = _missing(node)
        expected = smooth(missing)
        inside = ((expected > 1) & (expected < [width - 2, height - 2])).all(1)
        missing, expected = missing[inside], expected[inside]
        if not len(missing):
            break
        slopes = smooth.slopes(missing)
        start = start_parameters(expected, slopes, sigma, blur)
        extra = fit_crossings(image, start, slopes, blur)
        added = _plausible(extra, expected, slopes)
        parameters = np.concatenate([parameters, extra.parameters[added]])
        node = np.concatenate([node, missing[added]])
        if not added.any():
            break
    slopes = smooth.slopes(node)
    fit = fit_crossings(image, parameters, slopes, blur, noise)
    good = _plausible(fit, SmoothMap(node, fit.pixel)(node), slopes) & _like_neighbours(fit)
    good &= ((fit.pixel > -0.5) & (fit.pixel < [width - 0.5, height - 0.5])).all(1)
    good[good] = SmoothMap(node[good], fit.pixel[good]).inlier(fit.std[good])
    if good.sum() < LIMITS.min_nodes:
        raise CalibrationError(
            f"only {good.sum()} usable crossings of strings were found, {LIMITS.min_nodes} at least are "
            "needed: photograph the target nearer, sharper, or with more of it in view"
        )
    notes = (f"{(~good).sum()} crossings of {len(good)} left out (hidden, spoilt or out of place)",)
    return fit.only(good), node[good], notes


def _under_marks(node: Nodes) -> Mask:
    """Return a mask (n,), True for the nodes (0, 0) and (1, 0), which are covered by the two discs."""
    out: Mask = (node[:, 1] == 0) & ((node[:, 0] == 0) | (node[:, 0] == 1))
    return out


def _missing(node: Nodes) -> Nodes:
    """Return nodes (m, 2) that have not been found, up to two indices from the found nodes `node` (n, 2).
    Nodes under a disc are left out."""
    places = around(node, WINDOW)
    present = set(map(tuple, node))
    return np.array([n for n in places[~_under_marks(places)] if tuple(n) not in present]).reshape(-1, 2)


def _plausible(fit: Crossings, expected: Array, slopes: Array) -> Mask:
    """Return a mask (n,), True for crossings near `expected` (n, 2), px, with strings along `slopes`.
    `slopes` (n, 2, 2) are the steps to the next nodes, px. At least three of the four arms must be bright."""
    length = np.hypot(slopes[..., 0], slopes[..., 1])
    turn = fit.angle - np.arctan2(slopes[..., 1], slopes[..., 0])
    turn = np.abs((turn + np.pi / 2) % np.pi - np.pi / 2)
    distance = np.hypot(*(fit.pixel - expected).T)
    out: Mask = (
        (fit.std < 0.3)
        & (distance < np.minimum(2.5, 0.2 * length.min(1)))
        & (turn < 0.06).all(1)
        & (fit.flux > 0).all(1)
        & ((fit.arms > 0.45).sum(1) >= 3)
        & (fit.arms.max(1) < 2.2)
    )
    return out


def _like_neighbours(fit: Crossings) -> Mask:
    """Return a mask (n,), True for crossings with strings about as wide and bright as those nearby."""
    _, near = cKDTree(fit.pixel).query(fit.pixel, min(13, len(fit.pixel)))
    width = fit.sigma / np.median(fit.sigma[near], axis=1)
    flux = fit.flux / np.median(fit.flux[near], axis=1)
    misfit = fit.misfit / np.median(fit.misfit[near], axis=1)
    usual: Mask = ((width > 0.5) & (width < 1.8) & (flux > 0.3) & (flux < 3.0)).all(1)
    usual &= misfit < 4.0
    return usual


def _lens_blur(image: Image, fit: Crossings, slopes: Array, good: Mask) -> float:
    """Return the standard deviation, px, of the blur by lens and pixel that fits a few crossings best.
    The crossings are a sample of those for which `good` (n,) is True."""
    chosen = np.flatnonzero(good)
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(MAX_BLUR_CROSSINGS, len(chosen))).astype(int)]
    misfit = np.empty(len(BLURS))
    for k, blur in enumerate(BLURS):
        start = fit.parameters[chosen].copy()
        start[:, WIDTH1 : WIDTH2 + 1] = 3.0 * (fit.sigma[chosen] ** 2 - blur**2)
        trial = fit_crossings(image, start, slopes[chosen], blur)
        misfit[k] = np.median(np.where(trial.misfit >= 0, trial.misfit, np.inf))
    k = int(np.clip(misfit.argmin(), 1, len(BLURS) - 2))
    curvature, slope, _ = np.polyfit(BLURS[k - 1 : k + 2], misfit[k - 1 : k + 2], 2)
    lowest = -slope / (2 * curvature) if curvature > 0 else BLURS[misfit.argmin()]
    return float(np.clip(lowest, BLURS[0], BLURS[-1]))


def _noise(fit: Crossings, good: Mask) -> tuple[float, float]:
    """Return the noise variance of a pixel at zero grey, and its increase per grey level.
    They are estimated from the residuals of the crossings for which `good` (n,) is True."""
    ground, at_ground, string, at_string = np.median(fit.noise[good], axis=0)
    slope = max((at_string - at_ground) / max(string - ground, 1e-3), 0.0)
    return max(at_ground - slope * ground, 0.1 * at_ground, 1e-4), slope
