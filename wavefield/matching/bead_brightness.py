"""Scores of blocks that do not depend on how bright each bead is in the one and in the other image.

Two cameras do not see a bead equally bright. Where images of beads overlap, such differences seem to be
motion: between cameras that is more than the noise of the sensors.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from wavefield.compiled import compiled
from wavefield.matching.matching_kernels import BLOCK, F

Array = np.ndarray

SIGMA = 2.2  # px: of the surroundings in which the light changes by one factor, about twice that of a bead
MIN_POWER_FRACTION = F(0.1)  # of the mean power of the light: where there is less, brightness is not fitted
BACKGROUND_PERCENTILE = 10.0

njit = compiled(fastmath={"contract"}, error_model="numpy")


@dataclass(frozen=True)
class BeadBrightness:
    """An image's light, and its gradients without what a change of the beads' brightness makes of it.

    With the light a above its background, a Gaussian mean <.> and e = MIN_POWER_FRACTION of the mean of
    <a a>, P r = r - a <a r> / (<a a> + e) removes the local factor of the light from a residual r.
    """

    light: Array  # (h, w): a
    relative: Array  # (h, w): a / (<a a> + e)
    gradients: Array  # (2, h, w): P of the gradients along x and y
    hessian: Array  # (3, ny, nx): their sums per block, gx gx, gx gy, gy gy
    strain: Array  # (8, ny, nx): `strain_moments` of them and of P of the second derivatives

    @staticmethod
    def of(image: Array, gradients: Array, bends: Array) -> BeadBrightness:
        """From an image (h, w), its gradients (2, h, w) and second derivatives xx, xy, yy (3, h, w)."""
        background = np.percentile(image[BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK], BACKGROUND_PERCENTILE)
        light = image - F(background)
        power = _mean(light * light)
        power += MIN_POWER_FRACTION * max(F(power.mean()), F(1e-12))
        relative = light / power
        gx, gy, *bent = (one - relative * _mean(light * one) for one in (*gradients, *bends))
        hessian = np.empty((3, image.shape[0] // BLOCK, image.shape[1] // BLOCK), F)
        for out, one, other in zip(hessian, (gx, gx, gy), (gx, gy, gy), strict=True):
            _block_sums(one, other, out)
        strain = np.zeros((8, *hessian.shape[1:]), F)  # none of the light itself, which P removes
        for number, bend in enumerate(bent):
            _block_sums(gx, bend, strain[2 + number])
            _block_sums(gy, bend, strain[5 + number])
        return BeadBrightness(light, relative, np.stack([gx, gy]), hessian, strain)

    def scores(self, residual: Array) -> Array:
        """Sums per block (2, ny, nx) of the gradients times P of a residual (h, w)."""
        rest = residual - self.relative * _mean(self.light * residual)
        out = np.empty((2, *self.hessian.shape[1:]), F)
        for gradient, to in zip(self.gradients, out, strict=True):
            _block_sums(gradient, rest, to)
        return out


def _mean(image: Array) -> Array:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), SIGMA, borderType=cv2.BORDER_REPLICATE))


@njit
def _block_sums(one: Array, other: Array, out: Array) -> None:
    """Sums per block of the product of two images (h, w)."""
    for by in range(out.shape[0]):
        out[by] = F(0)
        for j in range(BLOCK):
            p, q = one[by * BLOCK + j], other[by * BLOCK + j]
            for bx in range(out.shape[1]):
                total = F(0)
                for i in range(BLOCK):
                    total += p[bx * BLOCK + i] * q[bx * BLOCK + i]
                out[by, bx] += total
