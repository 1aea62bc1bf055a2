"""A lattice of nodes in an image: candidates, growth from a seed, and the smooth map behind it."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from wavefield.compiled import compiled
from wavefield.parabola import parabola_vertex
from wavefield.robust import robust_std

Array = NDArray[np.float64]

REACH = 100  # nodes a lattice may extend from its seed in each direction
SNAP = 0.22  # how far from its prediction a node may lie, in meshes
FAINT = 0.4  # a crossing is at least this strong, relative to those around it
WINDOW = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3), indexing="ij"), -1).reshape(-1, 2)


@dataclass(frozen=True)
class Candidates:
    """Places that look like a crossing of two bright strings at one scale."""

    pixel: Array  # (n, 2): Positions (X, Y), px
    strength: Array  # (n,): Curvature across the weaker of the two strings, grey per px^2
    scale: float  # Standard deviation of the smoothing, px

    @property
    def strong(self) -> NDArray[np.bool_]:
        """Those at least half as strong as the median of the 80 strongest."""
        return self.strength > 0.5 * np.median(np.sort(self.strength)[::-1][:80])


def crossings(image: NDArray[np.float32], scale: float) -> Candidates:
    """Local maxima of the weaker curvature of the smoothed image.

    Along a plain bright line one principal curvature vanishes; only where two lines cross (or on a
    blob) are both negative, so that the weaker one singles out crossings.

    With image (row, column); scale, px.
    """
    r = int(np.ceil(4 * scale))
    t = np.arange(-r, r + 1)
    g0 = np.exp(-0.5 * (t / scale) ** 2)
    g0 /= g0.sum()
    g1 = -t / scale**2 * g0
    g2 = (t**2 / scale**4 - 1 / scale**2) * g0
    xx = cv2.sepFilter2D(image, cv2.CV_32F, g2, g0)
    yy = cv2.sepFilter2D(image, cv2.CV_32F, g0, g2)
    xy = cv2.sepFilter2D(image, cv2.CV_32F, g1, g1)
    weaker = _weaker(*(np.asarray(part, np.float32) for part in (xx, yy, xy)))
    peak = (weaker == cv2.dilate(weaker, np.ones((5, 5), np.uint8))) & (weaker > 0)
    peak[:2], peak[-2:], peak[:, :2], peak[:, -2:] = False, False, False, False
    y, x = np.divmod(np.flatnonzero(peak), peak.shape[1])
    strength = weaker[y, x].astype(float)
    if not len(strength):
        return Candidates(np.empty((0, 2)), strength, scale)
    noise = np.median(np.abs(weaker[::4, ::4]))
    keep = strength > max(0.2 * np.median(np.sort(strength)[::-1][:80]), 2.3 * noise)
    x, y, strength = x[keep], y[keep], strength[keep]
    pixel = np.stack(
        [
            x + np.clip(parabola_vertex(weaker[y, x - 1], strength, weaker[y, x + 1]), -0.5, 0.5),
            y + np.clip(parabola_vertex(weaker[y - 1, x], strength, weaker[y + 1, x]), -0.5, 0.5),
        ],
        -1,
    )
    return Candidates(pixel, strength, scale)


@compiled()
def _weaker(xx: NDArray[np.float32], yy: NDArray[np.float32], xy: NDArray[np.float32]) -> NDArray[np.float32]:
    """The weaker of the two principal curvatures, positive on bright crossings and blobs."""
    half = np.float32(0.5)
    out = np.empty_like(xx)
    for i in range(xx.shape[0]):
        for k in range(xx.shape[1]):
            mean, apart = half * (xx[i, k] + yy[i, k]), half * (xx[i, k] - yy[i, k])
            out[i, k] = -(mean + np.sqrt(apart * apart + xy[i, k] * xy[i, k]))
    return out


def _windows(table: Array, node: NDArray[np.int64]) -> Array:
    """Entries of a table over indices within two of each node, (m, 25, ...)."""
    at = node[:, None] + WINDOW + REACH
    out: Array = table[at[..., 0], at[..., 1]]
    return out


class TargetLattice:
    """Positions of nodes over a square of indices, grown outwards from a seed.

    With start (2,); e1, e2 (2,).
    """

    def __init__(self, start: Array, e1: Array, e2: Array) -> None:
        self.place = np.full((2 * REACH + 1, 2 * REACH + 1, 2), np.nan)  # [i + REACH, j + REACH]
        self.place[REACH, REACH] = start
        self.slopes = np.stack([e1, e2])

    def __len__(self) -> int:
        return int(np.isfinite(self.place[..., 0]).sum())

    @property
    def node(self) -> NDArray[np.int64]:
        """Indices of the nodes, (n, 2)."""
        return np.argwhere(np.isfinite(self.place[..., 0])) - REACH

    @property
    def pixel(self) -> Array:
        """Their positions, (n, 2), px, in the order of `node`."""
        out: Array = self.place[np.isfinite(self.place[..., 0])]
        return out

    def front(self) -> NDArray[np.int64]:
        """Indices of the empty nodes that have a filled neighbour, (m, 2)."""
        known = np.isfinite(self.place[..., 0])
        near = cv2.dilate(known.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))) > 0
        empty = np.argwhere(near & ~known)
        return empty[((empty >= 2) & (empty < 2 * REACH - 1)).all(1)] - REACH

    def predict(self, node: NDArray[np.int64]) -> tuple[Array, Array]:
        """Where nodes should lie, from the nodes filled within two indices of them.

        A quadratic surface is fitted with weights falling with distance; the seed's vectors serve as a
        weak prior of its slopes, so that the first rings are well posed too.

        With node (m, 2); returns pixel (m, 2): Predicted positions, px; slopes (m, 2, 2): Local mesh vectors:
        [:, 0] along i, [:, 1] along j, px.
        """
        di, dj = WINDOW.astype(float).T
        basis = np.stack([np.ones(25), di, dj, di * dj, di * di, dj * dj], -1)
        window = _windows(self.place, node)  # (m, 25, 2)
        known = np.isfinite(window[..., 0])
        weight = known / (1.0 + di * di + dj * dj)
        prior = np.array([0.0, 1e-4, 1e-4, 0.3, 0.3, 0.3])
        weighted = weight[..., None] * basis
        normal = weighted.transpose(0, 2, 1) @ basis + np.diag(prior)
        right = weighted.transpose(0, 2, 1) @ np.where(known[..., None], window, 0.0)
        right[:, 1:3] += prior[1:3, None] * self.slopes
        fit = np.linalg.solve(normal, right)
        return fit[:, 0], fit[:, 1:3]

    def grow(self, candidates: Candidates, size: tuple[int, int]) -> None:
        """Fill node after node, ring by ring, with the candidates that lie where the lattice predicts.

        With size, px.
        """
        tree = cKDTree(candidates.pixel)
        used = np.zeros(len(candidates.pixel) + 1, bool)
        used[-1] = True  # stands for "none"
        first = tree.query(self.place[REACH, REACH])[1]
        used[first] = True
        strengths = np.zeros(self.place.shape[:2])  # of the filled nodes
        strengths[REACH, REACH] = candidates.strength[first]
        while len(front := self.front()):
            pixel, slopes = self.predict(front)
            reach = SNAP * np.hypot(slopes[..., 0], slopes[..., 1]).min(1)
            inside = ((pixel > 0) & (pixel < size)).all(1) & (reach > 1.0)
            front, pixel, reach = front[inside], pixel[inside], reach[inside]
            if not len(front):
                return
            distance, choice = tree.query(pixel, k=4, distance_upper_bound=float(reach.max()))
            strength = np.append(candidates.strength, 0.0)[choice]
            around = _windows(strengths, front)
            usual = around.sum(1) / np.maximum((around > 0).sum(1), 1)
            strength = np.where(strength > FAINT * usual[:, None], strength, 0.0)
            # the strongest of those near, so that a faint reflection beside a string is passed over
            merit = np.where(
                used[choice], 0.0, strength * (1 - np.minimum(distance / reach[:, None], 1) ** 2)
            )
            best = merit.argmax(1)
            row = np.arange(len(front))
            order = np.argsort(-merit[row, best], kind="stable")
            filled = 0
            for k in order[merit[order, best[order]] > 0]:
                c = choice[k, best[k]]
                if not used[c]:
                    used[c] = True
                    self.place[tuple(front[k] + REACH)] = candidates.pixel[c]
                    strengths[tuple(front[k] + REACH)] = candidates.strength[c]
                    filled += 1
            if not filled:
                return


class SmoothMap:
    """From indices to pixels: a homography, and a cubic in the image for what the lens bends.

    Radial distortion is a cubic in image coordinates whatever the obliquity of the target, therefore the
    correction is a polynomial of the homography's pixels and not of the indices.

    With node (n, 2); pixel (n, 2), px; tolerance, px.
    """

    def __init__(self, node: ArrayLike, pixel: ArrayLike, tolerance: float) -> None:
        node, pixel = np.asarray(node, float), np.asarray(pixel, float)
        matrix, vote = cv2.findHomography(node, pixel, cv2.RANSAC, tolerance)
        if matrix is None:
            raise ValueError("no homography")
        vote = vote.ravel().astype(bool)
        self.matrix = matrix
        self.shift, self.scale = pixel.mean(0), max(float(np.ptp(pixel)) / 2, 1.0)
        degree = 3 if vote.sum() >= 40 else 1
        self.powers = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a)]
        q = self._homography(node)
        basis, rest = self._basis(q), pixel - q
        weight = vote.astype(float)
        for _ in range(8):
            w = weight[:, None]
            self.cubic = np.linalg.lstsq(basis * w, rest * w, rcond=None)[0]
            self.misfit = np.hypot(*(rest - basis @ self.cubic).T)
            self.spread = robust_std(self.misfit[vote]) / 1.177 + 1e-4  # per axis
            weight = 1.0 / np.sqrt(np.maximum(1.0, self.misfit / (3.0 * self.spread)) ** 3)

    def _homography(self, node: Array) -> Array:
        q = np.c_[node, np.ones(len(node))] @ self.matrix.T
        out: Array = q[:, :2] / np.where(np.abs(q[:, 2:]) > 1e-12, q[:, 2:], np.nan)
        return out

    def _basis(self, pixel: Array) -> Array:
        x, y = ((pixel - self.shift) / self.scale).T
        return np.stack([x**a * y**b for a, b in self.powers], -1)

    def __call__(self, node: ArrayLike) -> Array:
        """Positions of nodes, (n, 2), px."""
        q = self._homography(np.asarray(node, float))
        out: Array = q + self._basis(q) @ self.cubic
        return out

    def slopes(self, node: ArrayLike) -> Array:
        """Mesh vectors at nodes, (n, 2, 2): [:, 0] along i, [:, 1] along j, px."""
        node = np.asarray(node, float)
        h = 0.05
        return np.stack(
            [
                (self(node + step) - self(node - step)) / (2 * h)
                for step in (np.array([h, 0]), np.array([0, h]))
            ],
            1,
        )
