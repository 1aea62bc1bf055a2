"""The grid of white strings: its crossings, found without clicks and located to a hundredth of a pixel.

The steps: a lattice of crossings (`string_lattice`); the two discs that mark the origin and the x axis
(`string_marks`); a fit to the raw pixels of every crossing (`subpixel`); rejection of crossings that differ
from their neighbours in brightness, width or position.
"""

import numpy as np
from scipy.spatial import cKDTree

from wavefield.calibration.points import Image, Mask, Nodes, TargetPoints
from wavefield.calibration.smooth_map import SmoothMap
from wavefield.calibration.string_lattice import MIN_CROSSINGS, NO_GRID, best_lattice
from wavefield.calibration.string_marks import numbered_from_marks
from wavefield.calibration.subpixel import WIDTH1, WIDTH2, Crossings, fit_crossings, start_parameters
from wavefield.calibration.target import Target
from wavefield.calibration.target_lattice import around
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

PRELIMINARY_TOLERANCE = 5e-3  # px: of fits that are repeated
FIRST_BLUR = 0.6  # px: of the lens, before it is fitted
BLURS = np.array([0.36, 0.42, 0.48, 0.54, 0.6, 0.68, 0.78, 0.9, 1.1])  # px: tried for the lens
MAX_BLUR_CROSSINGS = 24  # by which the blur is fitted
MAP_TOLERANCE = 0.15  # meshes
NEIGHBOURS = np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)])


def find_strings(image: Image, target: Target) -> TargetPoints:
    """Find the crossings of a grid of white strings on a dark ground, in an image that is not mirrored.
    The calibration detects a mirrored one, because the target's poses then differ between cameras.
    """
    lattice, scale = best_lattice(image)
    node, pixel = lattice.node, lattice.pixel
    mesh = np.median(np.hypot(*np.moveaxis(lattice.predict(node)[1], -1, 0)))
    tolerance = MAP_TOLERANCE * mesh
    node = numbered_from_marks(image, _map(node, pixel, tolerance), node)
    fit, node, notes = _fitted(image, node, pixel, tolerance, scale)
    height, width = image.shape
    return TargetPoints(node, fit.pixel, fit.std, (width, height), notes)


def _fitted(
    image: Image, node: Nodes, pixel: Array, tolerance: float, scale: float
) -> tuple[Crossings, Nodes, tuple[str, ...]]:
    """Fit all crossings, then those that the lattice lacks; reject; fit once more with the noise found."""
    height, width = image.shape
    bare = ~_under_marks(node)
    node, pixel = node[bare], pixel[bare]
    smooth = _map(node, pixel, tolerance)
    near = smooth.misfit < tolerance
    node, pixel = node[near], pixel[near]
    slopes = smooth.slopes(node)
    start = start_parameters(pixel, slopes, 0.6 * scale, FIRST_BLUR)
    fit = fit_crossings(image, start, slopes, FIRST_BLUR, tolerance=PRELIMINARY_TOLERANCE)
    good = _plausible(fit, pixel, slopes)
    if good.sum() < MIN_CROSSINGS:
        raise CalibrationError(NO_GRID)
    noise = _noise(fit, good)
    sigma = float(np.median(fit.sigma[good]))
    blur = _lens_blur(image, fit, slopes, good)
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
        extra = fit_crossings(image, start, slopes, blur, tolerance=PRELIMINARY_TOLERANCE)
        added = _plausible(extra, expected, slopes)
        parameters = np.concatenate([parameters, extra.parameters[added]])
        node = np.concatenate([node, missing[added]])
        if not added.any():
            break
    slopes = smooth.slopes(node)
    fit = fit_crossings(image, parameters, slopes, blur, noise)
    good = _plausible(fit, _map(node, fit.pixel, tolerance)(node), slopes) & _like_neighbours(fit)
    good &= ((fit.pixel > -0.5) & (fit.pixel < [width - 0.5, height - 0.5])).all(1)
    smooth = _map(node[good], fit.pixel[good], tolerance)
    misfit = np.hypot(*(fit.pixel - smooth(node)).T)
    good &= misfit < np.maximum(6 * np.hypot(smooth.spread, fit.std) * 1.2, 0.1)
    if good.sum() < MIN_CROSSINGS:
        raise CalibrationError(
            f"only {good.sum()} usable crossings of strings were found; at least {MIN_CROSSINGS} are needed"
        )
    notes = (f"{len(node) - good.sum()} crossings of {len(node)} left out (hidden, spoilt or out of place)",)
    return fit.only(good), node[good], notes


def _under_marks(node: Nodes) -> Mask:
    """Nodes covered by the two discs."""
    out: Mask = (node[:, 1] == 0) & ((node[:, 0] == 0) | (node[:, 0] == 1))
    return out


def _map(node: Nodes, pixel: Array, tolerance: float) -> SmoothMap:
    try:
        return SmoothMap(node, pixel, tolerance)
    except ValueError:
        raise CalibrationError(NO_GRID) from None


def _missing(node: Nodes) -> Nodes:
    """Nodes next to the present ones, and holes between them, without those under the marks."""
    places = around(node, NEIGHBOURS)
    present = set(map(tuple, node))
    return np.array([n for n in places[~_under_marks(places)] if tuple(n) not in present]).reshape(-1, 2)


def _plausible(fit: Crossings, expected: Array, slopes: Array) -> Mask:
    """Crossings that were fitted close to the expected pixels, with three arms along the mesh at least."""
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
    """Crossings whose strings are about as wide and bright as those of their neighbours."""
    _, near = cKDTree(fit.pixel).query(fit.pixel, min(13, len(fit.pixel)))
    width = fit.sigma / np.median(fit.sigma[near], axis=1)
    flux = fit.flux / np.median(fit.flux[near], axis=1)
    misfit = fit.misfit / np.median(fit.misfit[near], axis=1)
    usual: Mask = ((width > 0.5) & (width < 1.8) & (flux > 0.3) & (flux < 3.0)).all(1)
    usual &= misfit < 4.0
    return usual


def _lens_blur(image: Image, fit: Crossings, slopes: Array, good: Mask) -> float:
    """The blur with which a box and a Gaussian come closest to the strings' profiles, px."""
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
    """Variance of a pixel at zero grey and its increase per grey, from the residuals."""
    ground, at_ground, string, at_string = np.median(fit.noise[good], axis=0)
    slope = max((at_string - at_ground) / max(string - ground, 1e-3), 0.0)
    return max(at_ground - slope * ground, 0.1 * at_ground, 1e-4), slope
