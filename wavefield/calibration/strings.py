"""The grid of white strings: its crossings, found without clicks and located to a hundredth of a pixel.

The steps: candidates at several scales by curvature; a lattice grown from a seed whose two vectors run
along strings; the two discs that mark the origin and the x axis; a fit to the raw pixels of every crossing;
rejection of what does not look like its neighbours or does not lie where they say.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wavefield.calibration.points import TargetPoints
from wavefield.calibration.subpixel import WIDTH1, WIDTH2, Crossings, fit_crossings, start_parameters
from wavefield.calibration.target import Target
from wavefield.calibration.target_lattice import REACH, Candidates, SmoothMap, TargetLattice, crossings
from wavefield.errors import CalibrationError

Array = NDArray[np.float64]
Node = NDArray[np.int64]

SCALES = (1.5, 2.5, 4.0)  # px; a string may be under 2 px wide in one camera and 4 px in another
_NEAR = 5e-3  # px: how closely crossings are fitted that are fitted once more
FEWEST = 12  # crossings below which a picture is of no use


def find_strings(image: NDArray[np.float32], target: Target) -> TargetPoints:
    """Find the crossings of a grid of white strings on a dark ground.

    Two marks on one axis look the same in a mirrored picture. That the picture is not mirrored is taken
    for granted here; the calibration notices it, because the target's poses then differ between cameras.

    With image (row, column).
    """
    lattice, scale = _best_lattice(image)
    node, pixel = lattice.node, lattice.pixel
    mesh = np.median(np.hypot(*np.moveaxis(lattice.predict(node)[1], -1, 0)))
    try:
        smooth = SmoothMap(node, pixel, 0.15 * mesh)
    except ValueError:
        raise CalibrationError(_NONE) from None
    node = _oriented(image, smooth, node)
    fit, node, notes = _fitted(image, node, pixel, 0.15 * mesh, scale)
    height, width = image.shape
    return TargetPoints(node, fit.pixel, fit.std, (width, height), notes)


_NONE = (
    "no grid of white strings was found in the image; it needs a dark ground, and strings in focus that "
    "are brighter than it"
)


# -- the lattice --------------------------------------------------------------------------------------


def _best_lattice(image: NDArray[np.float32]) -> tuple[TargetLattice, float]:
    """The lattice whose meshes run along the most light, and the scale of its candidates."""
    best: TargetLattice | None = None
    best_scale, most = SCALES[0], 0.0
    size = image.shape[::-1]
    for scale in SCALES:
        candidates = crossings(image, scale)
        if len(candidates.pixel) < FEWEST:
            continue
        for start, e1, e2 in _seeds(image, candidates):
            lattice = TargetLattice(start, e1, e2)
            lattice.grow(candidates, size)
            if len(lattice) < FEWEST:
                continue
            light = _light_along(image, lattice)
            if light > 1.03 * most:
                best, best_scale, most = lattice, scale, light
            if len(lattice) > 0.6 * candidates.strong.sum():
                break
    if best is None:
        raise CalibrationError(_NONE)
    return best, best_scale


def _light_along(image: NDArray[np.float32], lattice: TargetLattice) -> float:
    """Light on the lines between neighbouring nodes above that beside them, summed over their length.

    A lattice that noise or dirt suggests has many nodes, but no strings between them.
    """
    place, known = lattice.place, np.isfinite(lattice.place[..., 0])
    along = np.linspace(0.25, 0.75, 16)[None, :, None]
    total = 0.0
    for axis in (0, 1):
        pair = np.argwhere(known & np.roll(known, -1, axis))
        step = np.eye(2, dtype=int)[axis]
        here, there = place[tuple(pair.T)], place[tuple((pair + step).T)]
        aside = 0.22 * lattice.predict(pair - REACH)[1][:, 1 - axis][:, None]
        line = here[:, None] + along * (there - here)[:, None]
        on, off = _sample(image, line), (_sample(image, line + aside) + _sample(image, line - aside)) / 2
        total += float(((on - off).mean(1) * np.hypot(*(there - here).T)).sum())
    return total


def _seeds(
    image: NDArray[np.float32], candidates: Candidates, most: int = 12
) -> list[tuple[Array, Array, Array]]:
    """Crossings near the middle with two neighbours each along a string: (start, e1, e2), right-handed."""
    height, width = image.shape
    ridge = _ridges(image, candidates.scale)
    strong = candidates.strong
    pixel = candidates.pixel[strong]
    if len(pixel) < FEWEST:
        return []
    bright = np.median(_sample(ridge, pixel))
    tree = cKDTree(pixel)
    middle = np.argsort(np.hypot(*(pixel - [width / 2, height / 2]).T))
    seeds = []
    for k in middle[:120:3]:
        _, near = tree.query(pixel[k], min(13, len(pixel)))
        arms = pixel[near[1:]] - pixel[k]
        arms = arms[np.hypot(*arms.T) > 4 * candidates.scale]
        along = np.linspace(0.2, 0.8, 22)[None, :, None]
        lit = _sample(ridge, pixel[k] + along * arms[:, None])
        arms = arms[np.percentile(lit, 15, axis=1) > 0.35 * bright] if len(arms) else arms
        pair = _independent(arms)
        if pair is not None:
            seeds.append((pixel[k], *pair))
        if len(seeds) == most:
            break
    return seeds


def _independent(arms: Array) -> tuple[Array, Array] | None:
    """The shortest arm and the shortest one not along it, ordered to be right-handed seen from above."""
    for a in range(len(arms)):
        for b in range(a + 1, len(arms)):
            cross = arms[a][0] * arms[b][1] - arms[a][1] * arms[b][0]
            if abs(cross) > 0.3 * np.hypot(*arms[a]) * np.hypot(*arms[b]):
                # rows run downwards in an image, therefore the cross product is negative
                return (arms[a], arms[b]) if cross < 0 else (arms[b], arms[a])
    return None


def _ridges(image: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
    """The image smoothed, less its local ground."""
    smooth = cv2.GaussianBlur(image, (0, 0), max(1.0, 0.5 * scale))
    ground = cv2.blur(cv2.erode(smooth, np.ones((15, 15), np.uint8)), (31, 31))
    return np.asarray(smooth, np.float32) - np.asarray(ground, np.float32)


def _sample(image: NDArray[np.float32], pixel: Array) -> NDArray[np.float32]:
    """Bilinear values at pixel positions (..., 2); those outside take the nearest pixel's value."""
    flat = pixel.reshape(-1, 2).astype(np.float32)
    rows = 30000  # cv2.remap takes no more than 32767 rows
    parts = [
        cv2.remap(image, part[:, :1], part[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in np.split(flat, range(rows, len(flat), rows))
    ]
    return np.asarray(np.concatenate(parts), np.float32).reshape(pixel.shape[:-1])


# -- the marks ----------------------------------------------------------------------------------------


def _oriented(image: NDArray[np.float32], smooth: SmoothMap, node: Node) -> Node:
    """Renumber nodes so that the larger disc is (0, 0) and the smaller one (1, 0)."""
    origin, step = _marks(image, smooth, node)
    rotation = np.array([[step[0], step[1]], [-step[1], step[0]]])
    out: Node = (node - origin) @ rotation.T
    return out


def _marks(image: NDArray[np.float32], smooth: SmoothMap, node: Node) -> tuple[Node, Node]:
    """Node of the larger disc, and the step from it to the smaller one."""
    height, width = image.shape
    around = np.unique(
        (node[:, None] + np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])).reshape(-1, 2), axis=0
    )
    pixel = smooth(around)
    inside = ((pixel > 2) & (pixel < [width - 3, height - 3])).all(1)
    around, pixel = around[inside], pixel[inside]
    row = np.full((2 * REACH + 3, 2 * REACH + 3), -1)
    row[tuple((around + REACH + 1).T)] = np.arange(len(around))
    value, usual = _rings(
        np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7), np.float32), pixel, smooth.slopes(around)
    )
    found = None
    # all directions first; if a spot of light or dirt spoils a disc, the median over directions
    middle = np.median(value, axis=2, keepdims=True), np.median(usual, axis=1, keepdims=True)
    for (rings, strings), least in (((value, usual), 0.7), (middle, 1.5)):
        quality, radius, grey = _discs(rings, strings)
        merits: list[tuple[float, tuple[Node, Node] | None]] = [(0.0, None)]
        for a in np.flatnonzero(quality > least):
            for step in np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]):
                b = row[tuple(around[a] + step + REACH + 1)]
                if b < 0 or quality[b] < least or radius[b] > 0.9 * radius[a]:
                    continue
                clearest = max(quality[a], quality[b]) > 0.5 * quality.max()
                if clearest and 0.2 < quality[b] / quality[a] < 5.0 and 0.5 < grey[b] / grey[a] < 2.0:
                    merit = min(quality[a], quality[b]) * min(grey[a], grey[b])
                    merits.append((merit, (around[a], step)))
        merits.sort(key=lambda pair: -pair[0])
        if len(merits) > 1 and merits[0][0] > 1.3 * merits[1][0]:
            found = merits[0][1]
            break
    if found is None:
        raise CalibrationError(
            f"a grid of {len(node)} crossings was found, but not its marks: the larger disc on the origin "
            "and the smaller one on the next crossing along +x must both be in view, clean and without glare"
        )
    return found


_RADII = np.linspace(0.02, 0.45, 30)  # of the circles on which marks are looked for, meshes


def _rings(image: NDArray[np.float32], pixel: Array, slopes: Array) -> tuple[Array, Array]:
    """Light on circles of the target's plane around nodes, in directions away from the strings.

    Returns what a node has more than a node without a disc, (node, circle, direction), and what that one has.
    """
    angle = (np.arange(32) + 0.5) * (2 * np.pi / 32)
    angle = angle[np.abs(np.sin(2 * angle)) > 0.5]
    offset = _RADII[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    value = _sample(image, pixel[:, None, None] + offset @ slopes[:, None]).astype(float)
    value -= np.median(value[:, -10:], axis=(1, 2), keepdims=True)
    usual = np.median(value, axis=0)
    return value - usual, usual


def _discs(value: Array, usual: Array) -> tuple[Array, Array, Array]:
    """How much the surroundings of each node look like a disc of even brightness.

    A disc adds the less, the brighter the node is without it.

    Returns the quality (what the best disc explains over what it leaves), its radius in meshes, its grey.
    """
    noise = np.median(np.abs(value[:, -10:])) + 1e-3
    radii = np.linspace(0.05, 0.38, 34)
    disc = np.clip((radii[:, None] - _RADII) / 0.05 + 0.5, 0, 1)[..., None] * np.clip(
        1 - usual / usual.max(), 0, 1
    )
    area = np.broadcast_to(np.sqrt(_RADII)[:, None], value.shape[1:])
    disc = (disc * area).reshape(len(radii), -1)
    norm = np.linalg.norm(disc, axis=1)
    white = np.inf
    for _ in range(2):
        light = (np.minimum(value, white) * area).reshape(len(value), -1)
        length = np.linalg.norm(light, axis=1) + 1e-9
        share = light @ (disc / norm[:, None]).T / length[:, None]
        best = share.argmax(1)
        share = np.clip(share[np.arange(len(value)), best], 0, 0.9999)
        grey = share * length / norm[best]
        significant = grey > max(5 * noise, 0.3 * usual.max())
        quality = np.where(significant, share / np.sqrt(1 - share**2), 0.0)
        white = 1.2 * grey[quality.argmax()]  # spots brighter than the discs count no more than they
    return quality, radii[best], np.maximum(grey, 1e-6)


# -- the fit and what is rejected ------------------------------------------------------------------------


def _fitted(
    image: NDArray[np.float32], node: Node, pixel: Array, tolerance: float, scale: float
) -> tuple[Crossings, Node, tuple[str, ...]]:
    """Fit all crossings, then those that the lattice lacks; reject; fit once more with the noise found."""
    height, width = image.shape
    blur = 0.6
    free = ~_marked(node)
    node, pixel = node[free], pixel[free]
    smooth = _map(node, pixel, tolerance)
    near = smooth.misfit < tolerance
    node, pixel = node[near], pixel[near]
    slopes = smooth.slopes(node)
    start = start_parameters(pixel, slopes, 0.6 * scale, blur)
    fit = fit_crossings(image, start, slopes, blur, close=_NEAR)
    good = _sound(fit, pixel, slopes)
    if good.sum() < FEWEST:
        raise CalibrationError(_NONE)
    sigma = float(np.median(fit.sigma[good]))
    blur = _blur(image, fit, slopes, good)
    parameters, node = fit.parameters[good], node[good]
    for _ in range(3):
        smooth = _map(node, parameters[:, :2], tolerance)
        missing = _missing(node)
        expected = smooth(missing)
        inside = ((expected > 1) & (expected < [width - 2, height - 2])).all(1)
        missing, expected = missing[inside], expected[inside]
        if not len(missing):
            break
        slopes = smooth.slopes(missing)
        start = start_parameters(expected, slopes, sigma, blur)
        extra = fit_crossings(image, start, slopes, blur, close=_NEAR)
        sound = _sound(extra, expected, slopes)
        parameters, node = (
            np.concatenate([parameters, extra.parameters[sound]]),
            np.concatenate([node, missing[sound]]),
        )
        if not sound.any():
            break
    slopes = smooth.slopes(node)
    fit = fit_crossings(image, parameters, slopes, blur, _noise(fit, good))
    smooth = _map(node, fit.pixel, tolerance)
    good = _sound(fit, smooth(node), slopes) & _alike(fit)
    good &= ((fit.pixel > -0.5) & (fit.pixel < [width - 0.5, height - 0.5])).all(1)
    smooth = _map(node[good], fit.pixel[good], tolerance)
    away = np.hypot(*(fit.pixel - smooth(node)).T)
    good &= away < np.maximum(6 * np.hypot(smooth.spread, fit.std) * 1.2, 0.1)
    if good.sum() < FEWEST:
        raise CalibrationError(
            f"only {good.sum()} sound crossings of strings were found; at least {FEWEST} are needed"
        )
    notes = (f"{len(node) - good.sum()} crossings of {len(node)} left out (hidden, spoilt or out of place)",)
    return _take(fit, good), node[good], notes


def _marked(node: Node) -> NDArray[np.bool_]:
    """Nodes covered by the two discs."""
    out: NDArray[np.bool_] = (node[:, 1] == 0) & ((node[:, 0] == 0) | (node[:, 0] == 1))
    return out


def _map(node: Node, pixel: Array, tolerance: float) -> SmoothMap:
    try:
        return SmoothMap(node, pixel, tolerance)
    except ValueError:
        raise CalibrationError(_NONE) from None


def _missing(node: Node) -> Node:
    """Nodes beside the known ones, and holes between them, without the marked ones."""
    steps = np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)])
    around = np.unique((node[:, None] + steps).reshape(-1, 2), axis=0)
    known = set(map(tuple, node))
    return np.array([n for n in around[~_marked(around)] if tuple(n) not in known]).reshape(-1, 2)


def _sound(fit: Crossings, expected: Array, slopes: Array) -> NDArray[np.bool_]:
    """Crossings that were fitted, stayed where they were expected, and have three arms along the mesh."""
    length = np.hypot(slopes[..., 0], slopes[..., 1])
    turn = fit.angle - np.arctan2(slopes[..., 1], slopes[..., 0])
    turn = np.abs((turn + np.pi / 2) % np.pi - np.pi / 2)
    moved = np.hypot(*(fit.pixel - expected).T)
    out: NDArray[np.bool_] = (
        (fit.std < 0.3)
        & (moved < np.minimum(2.5, 0.2 * length.min(1)))
        & (turn < 0.06).all(1)
        & (fit.flux > 0).all(1)
        & ((fit.arms > 0.45).sum(1) >= 3)
        & (fit.arms.max(1) < 2.2)
    )
    return out


def _alike(fit: Crossings) -> NDArray[np.bool_]:
    """Crossings whose strings are about as wide and bright as those of their neighbours."""
    _, near = cKDTree(fit.pixel).query(fit.pixel, min(13, len(fit.pixel)))
    width = fit.sigma / np.median(fit.sigma[near], axis=1)
    flux = fit.flux / np.median(fit.flux[near], axis=1)
    misfit = fit.misfit / np.median(fit.misfit[near], axis=1)
    usual: NDArray[np.bool_] = ((width > 0.5) & (width < 1.8) & (flux > 0.3) & (flux < 3.0)).all(1)
    usual &= misfit < 4.0
    return usual


def _blur(image: NDArray[np.float32], fit: Crossings, slopes: Array, good: NDArray[np.bool_]) -> float:
    """The blur with which a box and a Gaussian come closest to the strings' profiles, px."""
    chosen = np.flatnonzero(good)
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(24, len(chosen))).astype(int)]
    trials = np.array([0.36, 0.42, 0.48, 0.54, 0.6, 0.68, 0.78, 0.9, 1.1])
    misfit = np.empty(len(trials))
    for k, trial in enumerate(trials):
        start = fit.parameters[chosen].copy()
        start[:, WIDTH1 : WIDTH2 + 1] = 3.0 * (fit.sigma[chosen] ** 2 - trial**2)
        again = fit_crossings(image, start, slopes[chosen], trial)
        misfit[k] = np.median(np.where(again.misfit >= 0, again.misfit, np.inf))
    k = int(np.clip(misfit.argmin(), 1, len(trials) - 2))
    bend, slope, _ = np.polyfit(trials[k - 1 : k + 2], misfit[k - 1 : k + 2], 2)
    lowest = -slope / (2 * bend) if bend > 0 else trials[misfit.argmin()]
    return float(np.clip(lowest, trials[0], trials[-1]))


def _noise(fit: Crossings, good: NDArray[np.bool_]) -> tuple[float, float]:
    """Variance of a pixel at zero grey and its increase per grey, from the residuals."""
    ground, at_ground, string, at_string = np.median(fit.noise[good], axis=0)
    slope = max((at_string - at_ground) / max(string - ground, 1e-3), 0.0)
    return max(at_ground - slope * ground, 0.1 * at_ground, 1e-4), slope


def _take(fit: Crossings, good: NDArray[np.bool_]) -> Crossings:
    return Crossings(**{name: value[good] for name, value in vars(fit).items()})
