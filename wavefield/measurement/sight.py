"""Where one camera sees the nodes, and how its displacements are sought."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching import Modes, PosteriorVariance, Prior, Slopes
from wavefield.matching.matching_kernels import BLOCK
from wavefield.measurement.elevation_model import FieldModel
from wavefield.measurement.regrid import BlockLattice
from wavefield.rig import Camera


class Sight:
    """Where one camera sees the nodes at any height, as polynomials in z.

    With x, y (ny, nx), metres; z_range (float, float), metres.
    """

    def __init__(
        self, camera: Camera, x: NDArray[Any], y: NDArray[Any], z_range: tuple[float, float]
    ) -> None:
        self.camera = camera
        w, h = camera.size
        ny, nx = h // BLOCK, w // BLOCK
        self.lattice = BlockLattice(0.5 * (BLOCK - 1), 0.5 * (BLOCK - 1), float(BLOCK), (ny, nx))
        # projection is a ratio of linear functions of z with |z| well below the distance: order 4 is exact
        # to better than a thousandth of a pixel
        low, high = z_range
        self.z_middle, self.z_half = 0.5 * (low + high), 0.5 * (high - low)
        knots = np.cos(np.pi * (np.arange(5) + 0.5) / 5)
        inverse = np.linalg.inv(np.vander(knots, increasing=True))
        values = []
        for t in knots:
            z = self.z_middle + self.z_half * t
            X, Y = camera.project(x, y, z)
            J = camera.jacobian(x, y, z)
            values.append(np.concatenate([[X, Y], np.moveaxis(J.reshape(*X.shape, 6), -1, 0)]))
        # (8, 5, ny, nx): X, Y, then the Jacobian row by row
        self.polynomial = np.einsum("pk,kfyx->fpyx", inverse, np.array(values)).astype(np.float32)
        self.field_model: FieldModel | None = None

    def use(self, prior: Prior) -> None:
        """Seek this camera's displacements."""
        if self.field_model is None or self.field_model.prior != prior:
            self.field_model = FieldModel(prior, self.lattice.shape, 0.0)

    @property
    def modes(self) -> Modes:
        """Cosines of the displacements."""
        assert self.field_model is not None
        return self.field_model.modes

    @property
    def spread(self) -> PosteriorVariance:
        """Variance of the displacements."""
        assert self.field_model is not None
        return self.field_model.spread

    def splined(self, waves: NDArray[Any], slopes: Slopes) -> NDArray[Any]:
        """Spline coefficients of displacements, as `Sought.splined`."""
        assert self.field_model is not None
        return self.field_model.splined(waves, slopes)

    def at(self, z: NDArray[Any]) -> NDArray[np.float32]:
        """Image position and Jacobian of the nodes at given heights.

        With z (ny, nx), metres; returns (8, ny, nx): X, Y (px of the binned image), then dX/dx, dX/dy, dX/dz,
        dY/dx, dY/dy, dY/dz (px per metre).
        """
        return self._evaluate(z, 8)

    def position(self, z: NDArray[Any]) -> NDArray[np.float32]:
        """Image position of the nodes at given heights.

        With z (ny, nx), metres; returns (2, ny, nx): X, Y, px of the binned image.
        """
        return self._evaluate(z, 2)

    def _evaluate(self, z: NDArray[Any], count: int) -> NDArray[np.float32]:
        t = (np.asarray(z, np.float32) - np.float32(self.z_middle)) / np.float32(self.z_half)
        out = self.polynomial[:count, 4].copy()
        for order in (3, 2, 1, 0):
            out *= t
            out += self.polynomial[:count, order]
        result: NDArray[np.float32] = out
        return result

    def sees(self, X: NDArray[Any], Y: NDArray[Any]) -> NDArray[np.bool_]:
        """Whether positions lie inside the binned image."""
        w, h = self.camera.size
        with np.errstate(invalid="ignore"):
            return (X >= 0) & (X <= w - 1) & (Y >= 0) & (Y <= h - 1)
