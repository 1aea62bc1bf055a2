"""Order marks in the image of a target as a grid of nodes, and fit a smooth map from indices to pixels.

A node is a string crossing or a dot with indices (i, j). A lattice is the grid of nodes found so far. It
grows from a seed, one node with its two mesh vectors, by one layer of neighbours after another. A mesh vector
is the step in the image, px, from a node to the next along i or j.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from wavefield.calibration.observations import MIN_OUTLIER_PX, OUTLIER_DEVIATIONS
from wavefield.calibration.points import Image, Mask, Nodes
from wavefield.compiled import compiled
from wavefield.errors import CalibrationError
from wavefield.parabola import parabola_vertex
from wavefield.rig.lens import Array
from wavefield.robust import reweighted_lstsq, robust_std

MAX_SEEDS = 12  # candidate seeds to try, as some of them may be dirt
REACH = 100  # largest index of a node relative to its seed
MAX_MISFIT = 0.22  # meshes between a node and its prediction; tuned on simulated string grids
MIN_STRENGTH = 0.4  # of a node, relative to the mean of its neighbours
MIN_SINE = 0.3  # of the angle between the two vectors of a seed: 17 degrees
WINDOW = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3), indexing="ij"), -1).reshape(-1, 2)


@dataclass(frozen=True)
class Candidates:
    """Points of an image that may be nodes of a target: crossings of bright strings, or dots."""

    pixel: Array  # (n, 2): Positions (X, Y), px
    strength: Array  # (n,): Curvature across the weaker string, grey per px^2; of a dot its area, px^2
    scale: float  # Standard deviation of the smoothing, px

    @property
    def strong(self) -> Mask:
        """Mask (n,), True if the strength is over half the median strength of the 80 strongest points."""
        return self.strength > 0.5 * _typical_strength(self.strength)


def _typical_strength(strength: Array) -> float:
    return float(np.median(np.sort(strength)[::-1][:80]))


def crossings(image: Image, scale: float) -> Candidates:
    """Find crossings of bright strings: maxima of the weaker principal curvature of a smoothed image.
    Along a string this curvature vanishes; only crossings and bright spots are curved in both directions.
    `scale` is the standard deviation of the Gaussian that smooths the image, px."""
    r = int(np.ceil(4 * scale))
    t = np.arange(-r, r + 1)
    g0 = np.exp(-0.5 * (t / scale) ** 2)
    g0 /= g0.sum()
    g1 = -t / scale**2 * g0
    g2 = (t**2 / scale**4 - 1 / scale**2) * g0
    xx = cv2.sepFilter2D(image, cv2.CV_32F, g2, g0)
    yy = cv2.sepFilter2D(image, cv2.CV_32F, g0, g2)
    xy = cv2.sepFilter2D(image, cv2.CV_32F, g1, g1)
    curvature = _weaker_curvature(*(np.asarray(part, np.float32) for part in (xx, yy, xy)))
    peak = (curvature == cv2.dilate(curvature, np.ones((5, 5), np.uint8))) & (curvature > 0)
    peak[:2], peak[-2:], peak[:, :2], peak[:, -2:] = False, False, False, False
    y, x = np.divmod(np.flatnonzero(peak), peak.shape[1])
    strength = curvature[y, x].astype(float)
    if not len(strength):
        return Candidates(np.empty((0, 2)), strength, scale)
    noise = np.median(np.abs(curvature[::4, ::4]))
    strong = strength > max(0.2 * _typical_strength(strength), 2.3 * noise)
    x, y, strength = x[strong], y[strong], strength[strong]
    pixel = np.stack(
        [
            x + np.clip(parabola_vertex(curvature[y, x - 1], strength, curvature[y, x + 1]), -0.5, 0.5),
            y + np.clip(parabola_vertex(curvature[y - 1, x], strength, curvature[y + 1, x]), -0.5, 0.5),
        ],
        -1,
    )
    return Candidates(pixel, strength, scale)


@compiled()
def _weaker_curvature(xx: Image, yy: Image, xy: Image) -> Image:
    """Return the weaker principal curvature of each pixel from the second derivatives `xx`, `yy` and `xy`.
    It is positive where the pixel is brighter than its surroundings in all directions."""
    half = np.float32(0.5)
    out = np.empty_like(xx)
    for i in range(xx.shape[0]):
        for k in range(xx.shape[1]):
            mean, apart = half * (xx[i, k] + yy[i, k]), half * (xx[i, k] - yy[i, k])
            out[i, k] = -(mean + np.sqrt(apart * apart + xy[i, k] * xy[i, k]))
    return out


def cross(a: Array, b: Array) -> float:
    """Return the cross product a[0] b[1] - a[1] b[0] of two vectors (2,)."""
    return float(a[0] * b[1] - a[1] * b[0])


def independent_pair(arms: Array) -> tuple[Array, Array] | None:
    """Return the first two of the vectors `arms` (n, 2) that are not nearly parallel, or None."""
    for k, a in enumerate(arms):
        for b in arms[k + 1 :]:
            if abs(cross(a, b)) > MIN_SINE * np.hypot(*a) * np.hypot(*b):
                return a, b
    return None


def most_central(points: Array, count: int) -> list[int]:
    """Return the indices of the `count` points that are nearest to the median of all points (n, 2)."""
    order: list[int] = np.argsort(np.hypot(*(points - np.median(points, 0)).T))[:count].tolist()
    return order


def around(node: Nodes, steps: Nodes) -> Nodes:
    """Return the different sums (k, 2) of one of the indices `node` (n, 2) and one of `steps` (m, 2)."""
    return np.unique((node[:, None] + steps).reshape(-1, 2), axis=0)


def _windows(table: Array, node: Nodes) -> Array:
    """Return the entries of `table` at the 5 x 5 nodes around each `node` (m, 2), as (m, 25, ...).
    The entry of the node with the indices (i, j) is ``table[i + REACH, j + REACH]``."""
    index = node[:, None] + WINDOW + REACH
    out: Array = table[index[..., 0], index[..., 1]]
    return out


class TargetLattice:
    """Nodes of a target found in an image, with indices and pixels; `grow` adds more from the first outwards.
    The first node is at `start` (2,), px; e1 and e2 (2,), px, are the steps to the next along i and j."""

    def __init__(self, start: Array, e1: Array, e2: Array) -> None:
        self.place = np.full((2 * REACH + 1, 2 * REACH + 1, 2), np.nan)  # [i + REACH, j + REACH], px
        self.place[REACH, REACH] = start
        self.slopes = np.stack([e1, e2])

    @property
    def filled(self) -> Mask:
        """Mask (2 REACH + 1, 2 REACH + 1), True at [i + REACH, j + REACH] if node (i, j) has been found."""
        out: Mask = np.isfinite(self.place[..., 0])
        return out

    def __len__(self) -> int:
        return int(self.filled.sum())

    @property
    def node(self) -> Nodes:
        """Indices (i, j) of the nodes found, (n, 2), counted from the first node."""
        return np.argwhere(self.filled) - REACH

    @property
    def pixel(self) -> Array:
        """Pixels of the nodes found, (n, 2), in the order of `node`."""
        out: Array = self.place[self.filled]
        return out

    def front(self) -> Nodes:
        """Return the indices (m, 2) of the nodes that have not been found but are next to a found node."""
        near = cv2.dilate(self.filled.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)))
        empty = np.argwhere((near > 0) & ~self.filled)
        return empty[((empty >= 2) & (empty < 2 * REACH - 1)).all(1)] - REACH

    def predict(self, node: Nodes) -> tuple[Array, Array]:
        """Return the predicted pixels (m, 2) of nodes (m, 2), and the steps (m, 2, 2) to the next nodes, px.
        The prediction is from found nodes nearby. Steps [:, 0] are along the index i, [:, 1] along j."""
        di, dj = WINDOW.astype(float).T
        basis = np.stack([np.ones(25), di, dj, di * dj, di * di, dj * dj], -1)
        window = _windows(self.place, node)  # (m, 25, 2)
        filled = np.isfinite(window[..., 0])
        weight = filled / (1.0 + di * di + dj * dj)
        prior = np.array([0.0, 1e-4, 1e-4, 0.3, 0.3, 0.3])
        weighted = (weight[..., None] * basis).transpose(0, 2, 1)
        normal = weighted @ basis + np.diag(prior)
        right = weighted @ np.where(filled[..., None], window, 0.0)
        right[:, 1:3] += prior[1:3, None] * self.slopes
        fit = np.linalg.solve(normal, right)
        return fit[:, 0], fit[:, 1:3]

    def grow(self, candidates: Candidates, size: tuple[int, ...]) -> None:
        """Add candidates near the predicted pixels of neighbouring nodes, layer by layer, until none fits.
        `size` is the (width, height) of the image, px."""
        tree = cKDTree(candidates.pixel)
        used = np.zeros(len(candidates.pixel) + 1, bool)
        used[-1] = True  # the tree's index for "none"
        first = tree.query(self.place[REACH, REACH])[1]
        used[first] = True
        strengths = np.zeros(self.place.shape[:2])  # of the filled nodes
        strengths[REACH, REACH] = candidates.strength[first]
        while len(front := self.front()):
            pixel, slopes = self.predict(front)
            reach = MAX_MISFIT * np.hypot(slopes[..., 0], slopes[..., 1]).min(1)
            inside = ((pixel > 0) & (pixel < size)).all(1) & (reach > 1.0)
            front, pixel, reach = front[inside], pixel[inside], reach[inside]
            if not len(front):
                return
            distance, choice = tree.query(pixel, k=4, distance_upper_bound=float(reach.max()))
            strength = np.append(candidates.strength, 0.0)[choice]
            nearby = _windows(strengths, front)
            usual = nearby.sum(1) / np.maximum((nearby > 0).sum(1), 1)
            strength = np.where(strength > MIN_STRENGTH * usual[:, None], strength, 0.0)
            # strength counts as well as distance: the reflection of a string may be nearer, but it is fainter
            closeness = 1 - np.minimum(distance / reach[:, None], 1) ** 2
            score = np.where(used[choice], 0.0, strength * closeness)
            best = score.argmax(1)
            score = score[np.arange(len(front)), best]
            filled_any = False
            for k in np.argsort(-score, kind="stable"):
                c = choice[k, best[k]]
                if score[k] > 0 and not used[c]:
                    used[c] = filled_any = True
                    index = tuple(front[k] + REACH)
                    self.place[index], strengths[index] = candidates.pixel[c], candidates.strength[c]
            if not filled_any:
                return


MIN_NODES_FOR_CUBIC = 40  # four times the ten coefficients of a cubic


class SmoothMap:
    """A smooth map from node indices (n, 2) to pixels (n, 2): a homography plus a polynomial of the pixel.
    The polynomial is cubic, or linear for fewer than 40 nodes. Outliers have little weight. Raises a
    CalibrationError if no homography fits the nodes."""

    def __init__(self, node: ArrayLike, pixel: ArrayLike) -> None:
        node, pixel = np.asarray(node, float), np.asarray(pixel, float)
        tolerance = max(1.0, 0.1 * mesh_length(node, pixel))  # px: wide enough for the lens distortion
        matrix, vote = cv2.findHomography(node, pixel, cv2.RANSAC, tolerance)
        if matrix is None:
            raise CalibrationError("the points found are not on a plane target; photograph it again")
        inlier = vote.ravel().astype(bool)
        self.matrix = matrix
        self.shift, self.scale = pixel.mean(0), max(float(np.ptp(pixel)) / 2, 1.0)
        degree = 3 if inlier.sum() >= MIN_NODES_FOR_CUBIC else 1
        self.powers = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a)]

        def spread(misfit: Array) -> float:
            return robust_std(misfit[inlier]) + 1e-4

        def reweight(residual: Array) -> Array:
            misfit = np.hypot(*residual.T)
            weight: Array = 1.0 / np.sqrt(np.maximum(1.0, misfit / (2.5 * spread(misfit))) ** 3)
            return weight

        q = self._homography(node)
        self.cubic, rest = reweighted_lstsq(self._basis(q), pixel - q, inlier.astype(float), reweight, 8)
        self.misfit: Array = np.hypot(*rest.T)  # distance of each node from the map, px
        self.spread = spread(self.misfit)  # px

    def inlier(self, std: Array | float = 0.0) -> Mask:
        """Return a mask (n,), True for the fitted nodes that are not outliers from the map.
        `std` is the standard uncertainty of the pixels of the nodes, px."""
        out: Mask = self.misfit < np.maximum(OUTLIER_DEVIATIONS * np.hypot(self.spread, std), MIN_OUTLIER_PX)
        return out

    def _homography(self, node: Array) -> Array:
        q = np.c_[node, np.ones(len(node))] @ self.matrix.T
        out: Array = q[:, :2] / np.where(np.abs(q[:, 2:]) > 1e-12, q[:, 2:], np.nan)
        return out

    def _basis(self, pixel: Array) -> Array:
        x, y = ((pixel - self.shift) / self.scale).T
        return np.stack([x**a * y**b for a, b in self.powers], -1)

    def __call__(self, node: ArrayLike) -> Array:
        """Return the pixels (n, 2) of nodes with the indices `node` (n, 2), which may be fractions."""
        q = self._homography(np.asarray(node, float))
        out: Array = q + self._basis(q) @ self.cubic
        return out

    def slopes(self, node: ArrayLike) -> Array:
        """Return the steps in the image, px, from nodes (n, 2) to the next nodes, as (n, 2, 2).
        The steps [:, 0] are along the index i, the steps [:, 1] along j."""
        node = np.asarray(node, float)
        return np.stack([self(node + half) - self(node - half) for half in 0.5 * np.eye(2)], 1)


def mesh_length(node: Nodes, pixel: Array) -> float:
    """Return the first percentile of the distances between neighbouring nodes, px; 4 without neighbours.
    `node` (n, 2) are indices, `pixel` (n, 2) positions in the image."""
    distance, near = cKDTree(node).query(node, k=5, distance_upper_bound=1.01)
    a, b = np.nonzero(np.isfinite(distance) & (distance > 0))
    if not len(a):
        return 4.0
    return float(np.percentile(np.hypot(*(pixel[a] - pixel[near[a, b]]).T), 1))
