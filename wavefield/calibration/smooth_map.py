"""The smooth map from indices of a plane target's nodes to pixels."""

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from wavefield.calibration.points import Nodes
from wavefield.rig.lens import Array
from wavefield.robust import reweighted_lstsq, robust_std

MIN_NODES_FOR_CUBIC = 40
RAYLEIGH_MEDIAN = 1.177  # median length of a vector whose components have unit standard deviation
DIFFERENCE_STEP = 0.05  # meshes


class SmoothMap:
    """A homography, and a cubic of its pixels for the lens distortion, fitted robustly to nodes (n, 2).
    Radial distortion is a cubic in pixels, not in indices, whatever the obliquity of the target.
    """

    def __init__(self, node: ArrayLike, pixel: ArrayLike, tolerance: float) -> None:
        node, pixel = np.asarray(node, float), np.asarray(pixel, float)
        matrix, vote = cv2.findHomography(node, pixel, cv2.RANSAC, tolerance)
        if matrix is None:
            raise ValueError("no homography")
        inlier = vote.ravel().astype(bool)
        self.matrix = matrix
        self.shift, self.scale = pixel.mean(0), max(float(np.ptp(pixel)) / 2, 1.0)
        degree = 3 if inlier.sum() >= MIN_NODES_FOR_CUBIC else 1
        self.powers = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a)]

        def spread(misfit: Array) -> float:
            return robust_std(misfit[inlier]) / RAYLEIGH_MEDIAN + 1e-4

        def reweight(residual: Array) -> Array:
            misfit = np.hypot(*residual.T)
            weight: Array = 1.0 / np.sqrt(np.maximum(1.0, misfit / (3.0 * spread(misfit))) ** 3)
            return weight

        q = self._homography(node)
        self.cubic, rest = reweighted_lstsq(self._basis(q), pixel - q, inlier.astype(float), reweight, 8)
        self.misfit: Array = np.hypot(*rest.T)
        self.spread = spread(self.misfit)  # per axis, px

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
        steps = DIFFERENCE_STEP * np.eye(2)
        return np.stack(
            [(self(node + step) - self(node - step)) / (2 * DIFFERENCE_STEP) for step in steps], 1
        )


def mesh_length(node: Nodes, pixel: Array) -> float:
    """Shortest distance between neighbouring nodes, px (first percentile)."""
    distance, near = cKDTree(node).query(node, k=5, distance_upper_bound=1.01)
    a, b = np.nonzero(np.isfinite(distance) & (distance > 0))
    if not len(a):
        return 4.0
    return float(np.percentile(np.hypot(*(pixel[a] - pixel[near[a, b]]).T), 1))


def map_of_nodes(node: Nodes, pixel: Array) -> SmoothMap:
    """The smooth map with a tolerance of a tenth of a mesh, one pixel at least."""
    return SmoothMap(node, pixel, max(1.0, 0.1 * mesh_length(node, pixel)))
