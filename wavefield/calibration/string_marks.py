"""The two discs that mark the origin and the x axis of a grid of strings."""

import cv2
import numpy as np

from wavefield.calibration.points import Image, Nodes
from wavefield.calibration.smooth_map import SmoothMap
from wavefield.calibration.string_lattice import sample
from wavefield.calibration.target_lattice import REACH, around
from wavefield.errors import CalibrationError
from wavefield.rig.lens import Array

NEIGHBOURS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
CIRCLES = np.linspace(0.02, 0.45, 30)  # meshes: radii of the circles on which marks are sampled
DISC_RADII = np.linspace(0.05, 0.38, 34)  # meshes: radii of discs that are compared with the samples


def numbered_from_marks(image: Image, smooth: SmoothMap, node: Nodes) -> Nodes:
    """Renumber nodes so that the larger disc is (0, 0) and the smaller one (1, 0)."""
    origin, step = _marks(image, smooth, node)
    rotation = np.array([[step[0], step[1]], [-step[1], step[0]]])
    out: Nodes = (node - origin) @ rotation.T
    return out


def _marks(image: Image, smooth: SmoothMap, node: Nodes) -> tuple[Nodes, Nodes]:
    """Node of the larger disc, and the step from it to the smaller one."""
    height, width = image.shape
    places = around(node, np.vstack([[[0, 0]], NEIGHBOURS]))
    pixel = smooth(places)
    inside = ((pixel > 2) & (pixel < [width - 3, height - 3])).all(1)
    places, pixel = places[inside], pixel[inside]
    blurred = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.7), np.float32)
    excess, usual = _circles(blurred, pixel, smooth.slopes(places))
    # all directions first; if a spot of light or dirt spoils a disc, the median over directions
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
    """Merit, node of a disc, and step to a smaller one next to it; best first."""
    row = np.full((2 * REACH + 3, 2 * REACH + 3), -1)
    row[tuple((places + REACH + 1).T)] = np.arange(len(places))
    pairs = []
    for a in np.flatnonzero(quality > min_quality):
        for step in NEIGHBOURS:
            b = row[tuple(places[a] + step + REACH + 1)]
            if b < 0 or quality[b] < min_quality or radius[b] > 0.9 * radius[a]:
                continue
            clearest = max(quality[a], quality[b]) > 0.5 * quality.max()
            if clearest and 0.2 < quality[b] / quality[a] < 5.0 and 0.5 < grey[b] / grey[a] < 2.0:
                merit = min(quality[a], quality[b]) * min(grey[a], grey[b])
                pairs.append((merit, places[a], step))
    pairs.sort(key=lambda pair: -pair[0])
    return pairs


def _circles(image: Image, pixel: Array, slopes: Array) -> tuple[Array, Array]:
    """Light on circles of the target's plane around nodes, in directions away from the strings.
    Returns the excess over a node without a disc, (node, circle, direction), and the light around that one.
    """
    angle = (np.arange(32) + 0.5) * (2 * np.pi / 32)
    angle = angle[np.abs(np.sin(2 * angle)) > 0.5]
    offset = CIRCLES[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    value = sample(image, pixel[:, None, None] + offset @ slopes[:, None]).astype(float)
    value -= np.median(value[:, -10:], axis=(1, 2), keepdims=True)
    usual = np.median(value, axis=0)
    return value - usual, usual


def _discs(excess: Array, usual: Array) -> tuple[Array, Array, Array]:
    """Similarity of the light around each node to a disc of even brightness: quality, radius (meshes), grey.
    Quality: light that the best disc explains over the rest. A disc adds less light to a brighter node.
    """
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
        share = light @ (disc / norm[:, None]).T / length[:, None]
        best = share.argmax(1)
        share = np.clip(share[np.arange(len(excess)), best], 0, 0.9999)
        grey = share * length / norm[best]
        significant = grey > max(5 * noise, 0.3 * usual.max())
        quality = np.where(significant, share / np.sqrt(1 - share**2), 0.0)
        white = 1.2 * grey[quality.argmax()]  # spots brighter than the discs count no more than they
    return quality, DISC_RADII[best], np.maximum(grey, 1e-6)
