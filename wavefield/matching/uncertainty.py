"""How uncertain a displacement is: from the influence of each block to a standard deviation."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from wavefield.matching.lattice import BLOCK, BORDER, filtered, gaussian, window_sigma
from wavefield.matching.settings import Settings

_N = 128  # blocks: period of the Fourier transforms below
_CLUSTER = 5  # blocks: neighbours closer than this share pixels, gradients and noise


@lru_cache(maxsize=32)
def transfer_kernel(settings: Settings, gain: float = 1.0) -> np.ndarray:
    """Weight of each block's own displacement in the final vector, linear theory.

    Parameters
    ----------
    settings : Settings
        Window, smoother and number of steps at the finest level.
    gain : float
        What a step achieves of the way to the solution (1 on clean images, less where noise shortens steps).

    Returns
    -------
    (2 r + 1, 2 r + 1) float32
        The kernel, its centre at [r, r]; it sums to nearly 1.

    Notes
    -----
    Inverse Fourier transform of T, made by T <- S (T + gain W (1 - T)) for the window W and the smoother S of
    every step at every level.
    """
    k = 2 * np.pi * np.fft.fftfreq(_N)

    def transfer(weights: np.ndarray) -> np.ndarray:
        reach = len(weights) // 2
        return np.cos(np.outer(k, np.arange(-reach, reach + 1))) @ weights

    total = np.zeros((_N, _N))
    for level in reversed(range(settings.levels)):
        sigma = settings.smoother_sigma if level == 0 else settings.coarse_smoother_sigma
        w = transfer(gaussian(2**level * window_sigma(settings.window)).astype(float))
        g = transfer(gaussian(2**level * sigma).astype(float)) if sigma > 0 else np.ones(_N)
        smoother = 1 - (1 - g[:, None] * g) ** settings.smoother_order
        for _ in range(settings.iterations[settings.levels - 1 - level]):
            total = smoother * (total + gain * w[:, None] * w * (1 - total))
    kernel = np.fft.fftshift(np.fft.ifft2(total).real)
    reach = min(_N // 2 - 1, int(3 * settings.window / 5) + 3)
    middle = slice(_N // 2 - reach, _N // 2 + reach + 1)
    return kernel[middle, middle].astype(np.float32)


@lru_cache(maxsize=32)
def _separable(settings: Settings, gain: float, power: int) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Kernel (or its square) as a short sum of separable ones: rows and columns of its singular vectors."""
    kernel = transfer_kernel(settings, gain).astype(float) ** power
    if power == 2:
        kernel = _middle(kernel, 1e-3)
    left, size, right = np.linalg.svd(kernel)
    keep = int(np.sum(size > (1e-4 if power == 1 else 2e-3) * size[0]))
    return tuple(
        ((left[:, n] * size[n]).astype(np.float32), right[n].astype(np.float32)) for n in range(keep)
    )


def _middle(kernel: np.ndarray, lost: float) -> np.ndarray:
    """The smallest square in the middle of a positive kernel that leaves out no more than this share."""
    while len(kernel) > 3 and kernel[1:-1, 1:-1].sum() >= (1 - lost) * kernel.sum():
        lost -= 1 - kernel[1:-1, 1:-1].sum() / kernel.sum()
        kernel = kernel[1:-1, 1:-1]
    return kernel


def _convolved(field: np.ndarray, parts: tuple[tuple[np.ndarray, np.ndarray], ...]) -> np.ndarray:
    total = np.zeros_like(field)
    for column, row in parts:
        total += cv2.sepFilter2D(field, -1, row, column, borderType=BORDER)
    return total


def std_from_influence(
    influence: np.ndarray, settings: Settings, field: np.ndarray | None = None, gain: float = 1.0
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
    side = min(_CLUSTER, (int(settings.window / BLOCK) - 1) // 2 * 2 + 1)
    r = len(kernel) // 2
    near = slice(r - side // 2, r + side // 2 + 1)
    freedom = max(1 - 2 * kernel[near, near].sum() + side**2 * (kernel**2).sum(), 0.25)
    clusters = filtered(np.ascontiguousarray(influence, np.float32), np.ones(side, np.float32))
    variance = _convolved(clusters * clusters, _separable(settings, gain, 2))
    variance *= np.float32(1 / (side**2 * freedom))
    if field is not None:
        lost = field - _convolved(np.ascontiguousarray(field, np.float32), _separable(settings, gain, 1)) / (
            np.float32(kernel.sum())
        )
        variance += lost * lost
    return np.sqrt(np.maximum(variance, 0))
