"""Where one camera sees the nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.matching_kernels import BLOCK
from wavefield.measurement.rectify import binned
from wavefield.measurement.regrid import BlockLattice
from wavefield.rig import Camera

Float = NDArray[np.floating]

# Projection is a ratio of linear functions of z with |z| well below the distance: order 4 is exact to better
# than a thousandth of a pixel.
_ORDER = 4


class Sight:
    """Where one camera sees the nodes at any height, as polynomials in z, and the blocks of its image, px.
    `binning`: side of the squares of raw pixels averaged first, px; `camera` is that of the binned image.
    """

    def __init__(
        self, camera: Camera, binning: int, x: Float, y: Float, z_range: tuple[float, float]
    ) -> None:
        self.binning, self.camera = binning, binned(camera, binning)
        w, h = self.camera.size
        first = 0.5 * (BLOCK - 1)
        self.lattice = BlockLattice(first, first, float(BLOCK), (h // BLOCK, w // BLOCK))
        self._z_middle, self._z_half = 0.5 * (z_range[0] + z_range[1]), 0.5 * (z_range[1] - z_range[0])
        knots = np.cos(np.pi * (np.arange(_ORDER + 1) + 0.5) / (_ORDER + 1))
        values = []
        for t in knots:
            z = self._z_middle + self._z_half * t
            X, Y = self.camera.project(x, y, z)
            J = self.camera.jacobian(x, y, z)
            values.append(np.concatenate([[X, Y], np.moveaxis(J.reshape(*X.shape, 6), -1, 0)]))
        # (8, 5, ny, nx): X, Y, then the Jacobian row by row
        inverse = np.linalg.inv(np.vander(knots, increasing=True))
        self._polynomial = np.einsum("pk,kfyx->fpyx", inverse, np.array(values)).astype(np.float32)

    def at(self, z: Float, every: int = 1) -> NDArray[np.float32]:
        """Image position and Jacobian of every n-th node along x and y at heights z, metres: (8, ny, nx).
        X, Y (px of the binned image), then dX/dx, dX/dy, dX/dz, dY/dx, dY/dy, dY/dz (px per metre).
        """
        return self._evaluate(z, self._polynomial[..., ::every, ::every])

    def at_middle(self) -> NDArray[np.float64]:
        """Jacobian (2, 3) of the node in the middle at z = 0, px per metre."""
        ny, nx = self._polynomial.shape[-2:]
        here = self._polynomial[2:, :, ny // 2, nx // 2]
        return self._evaluate(np.zeros(()), here).reshape(2, 3).astype(np.float64)

    def position(self, z: Float) -> NDArray[np.float32]:
        """Image position X, Y of the nodes at heights z (ny, nx), metres: (2, ny, nx), px."""
        return self._evaluate(z, self._polynomial[:2])

    def _evaluate(self, z: Float, polynomial: Float) -> NDArray[np.float32]:
        t = (np.asarray(z, np.float32) - np.float32(self._z_middle)) / np.float32(self._z_half)
        out: NDArray[np.float32] = polynomial[:, _ORDER].copy()
        for order in range(_ORDER - 1, -1, -1):
            out *= t
            out += polynomial[:, order]
        return out

    def sees(self, X: Float, Y: Float) -> NDArray[np.bool_]:
        """Whether positions are inside the binned image."""
        w, h = self.camera.size
        with np.errstate(invalid="ignore"):
            return (X >= 0) & (X <= w - 1) & (Y >= 0) & (Y <= h - 1)
