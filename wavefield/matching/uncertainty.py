"""Standard uncertainty of a match (`Displacement.u_std`, `v_std`) from the influence of each block.

Uncertainties of a cube come from the posterior instead (`posterior_variance`).
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from wavefield.matching.block_lattice import BORDER, filtered
from wavefield.matching.matching_gain import transfer_kernel
from wavefield.matching.matching_kernels import BLOCK
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.noise import CLUSTER


@lru_cache(maxsize=32)
def _separable(settings: MatchSettings, gain: float) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Transfer kernel as a short sum of separable ones: rows and columns of its singular vectors."""
    left, size, right = np.linalg.svd(transfer_kernel(settings, gain).astype(float))
    keep = int(np.sum(size > 1e-4 * size[0]))
    return tuple(
        ((left[:, n] * size[n]).astype(np.float32), right[n].astype(np.float32)) for n in range(keep)
    )


@lru_cache(maxsize=32)
def _squared(settings: MatchSettings, gain: float) -> tuple[np.ndarray, float]:
    """Square of the transfer kernel as one separable kernel: weights along either axis, and its sum.

    The square of a round hump is nearly a Gaussian, and that is separable: its first singular vector, with
    the sum of all, gives the uncertainty of a block within 5 %, of most within 1 %.
    """
    kernel = _trimmed(transfer_kernel(settings, gain).astype(float) ** 2, 1e-3)
    along = np.abs(np.linalg.svd(kernel)[2][0])
    return (along / along.sum()).astype(np.float32), float(kernel.sum())


def _trimmed(kernel: np.ndarray, lost: float) -> np.ndarray:
    """The smallest square in the middle of a positive kernel that leaves out no more than this share."""
    while len(kernel) > 3 and kernel[1:-1, 1:-1].sum() >= (1 - lost) * kernel.sum():
        lost -= 1 - kernel[1:-1, 1:-1].sum() / kernel.sum()
        kernel = kernel[1:-1, 1:-1]
    return kernel


def _convolved(field: np.ndarray, parts: tuple[tuple[np.ndarray, np.ndarray], ...]) -> np.ndarray:
    kernel_sum = np.zeros_like(field)
    for column, row in parts:
        kernel_sum += cv2.sepFilter2D(field, -1, row, column, borderType=BORDER)
    return kernel_sum


def std_from_influence(
    influence: np.ndarray,
    settings: MatchSettings,
    field: np.ndarray | None = None,
    gain: float = 1.0,
) -> np.ndarray:
    """Standard uncertainty of a field from the influences of its blocks.

    Parameters
    ----------
    influence : (ny, nx) float32
        Influence of each block: of one displacement component, or any linear combination of several
        (as the height from several stereo pairs); the result has its unit.
    settings : Settings
        Those of the match.
    field : (ny, nx) float32, optional
        The measured field itself: adds what window and smoother take away from its short waves.
    gain : float
        As for `transfer_kernel`.

    Returns
    -------
    (ny, nx) float32
        Standard uncertainty.

    Notes
    -----
    sigma^2 = K^2 * (sum over n x n of the influences)^2 / (n^2 c) with n = 5, less where the window is
    not wider than that; c = 1 - 2 sum_nxn K + n^2 sum K^2 gives back what the fit itself took out of the
    residuals; * is convolution over the lattice, K the transfer kernel. With `field`, ((1 - K *) field)^2
    is added.
    """
    gain = round(float(gain), 2)
    kernel = transfer_kernel(settings, gain).astype(float)
    side = min(CLUSTER, (int(settings.window / BLOCK) - 1) // 2 * 2 + 1)
    r = len(kernel) // 2
    centre = slice(r - side // 2, r + side // 2 + 1)
    freedom = max(1 - 2 * kernel[centre, centre].sum() + side**2 * (kernel**2).sum(), 0.25)
    clusters = filtered(np.ascontiguousarray(influence, np.float32), np.ones(side, np.float32))
    weights, kernel_sum = _squared(settings, gain)
    variance = filtered(clusters * clusters, weights)
    variance *= np.float32(kernel_sum / (side**2 * freedom))
    if field is not None:
        lost = field - _convolved(np.ascontiguousarray(field, np.float32), _separable(settings, gain)) / (
            np.float32(kernel.sum())
        )
        variance += lost * lost
    out: np.ndarray = np.sqrt(np.maximum(variance, 0))
    return out
