"""Amplitude gain of matching for waves of displacement, by linear theory."""

from __future__ import annotations

import cv2
import numpy as np

from wavefield.matching.block_lattice import gaussian, window_sigma
from wavefield.matching.matching_kernels import BLOCK
from wavefield.matching.matching_settings import MatchSettings

FOOTPRINT_VARIANCE = 6.0  # px^2: of the area that a block's value represents in the elevation by two cameras
RESTORED_VARIANCE = 1.2  # px^2: more than blocks average displacements over, against what priors suppress


def transfer_function(settings: MatchSettings, kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
    """Gain of windows, smoother and steps for waves of displacement, by linear theory.

    Parameters
    ----------
    settings : MatchSettings
        Those of the match.
    kx, ky : ndarray, shapes that broadcast
        Wavenumbers along columns and rows, rad per block.

    Returns
    -------
    ndarray
        Amplitude gain.

    Notes
    -----
    T <- S (T + W (1 - T)) for the window W and the smoother S of every step at every level.
    """

    def response(weights: np.ndarray) -> np.ndarray:
        n = np.arange(len(weights)) - len(weights) // 2
        along_x, along_y = (np.cos(np.asarray(k)[..., None] * n) @ weights.astype(float) for k in (kx, ky))
        return np.asarray(along_x * along_y)

    total = np.zeros(np.broadcast_shapes(np.shape(kx), np.shape(ky)))
    for level in reversed(range(settings.levels)):
        sigma = settings.smoother_sigma if level == 0 else settings.coarse_smoother_sigma
        window = response(gaussian(2**level * window_sigma(settings.window)))
        smoother = np.ones_like(window)
        if sigma > 0:
            smoother = 1 - (1 - response(gaussian(2**level * sigma))) ** settings.smoother_order
        for _ in range(settings.iterations[settings.levels - 1 - level]):
            total = smoother * (total + window * (1 - total))
    return total


def footprint(kx: np.ndarray, ky: np.ndarray, variance: float = FOOTPRINT_VARIANCE) -> np.ndarray:
    """Gain of the area that a block's value is taken to represent.

    Parameters
    ----------
    kx, ky : ndarray, shapes that broadcast
        Wavenumbers along columns and rows, rad per block.
    variance : float
        Of that area, px^2.

    Returns
    -------
    ndarray
        Amplitude gain.
    """
    out: np.ndarray = np.exp(-0.5 * variance * (np.square(kx) + np.square(ky)) / BLOCK**2)
    return out


def averaged(fields: np.ndarray, variance: float) -> np.ndarray:
    """Fields (c, ny, nx) averaged over the area of such a variance, px^2, that a block's value represents."""
    side = 0.5 * variance / BLOCK**2
    kernel = np.array([side, 1.0 - 2.0 * side, side])
    return np.stack(
        [cv2.sepFilter2D(one, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT) for one in fields]
    )


def displacement_area(bead_width: float) -> float:
    """Variance of the area that a block's displacement is taken to represent, px^2.

    Parameters
    ----------
    bead_width : float
        Width of the beads' images at half their height, px.

    Returns
    -------
    float
        Of the block, 25/12, and of the beads' images: width^2 / 3 by matching drawn images of beads of 1.5 to
        4.2 px. And 1.2 more, which restores part of the short waves that priors suppress.

    Examples
    --------
    >>> [round(displacement_area(width), 2) for width in (1.5, 3.0)]
    [4.03, 6.28]
    """
    return BLOCK**2 / 12.0 + bead_width**2 / 3.0 + RESTORED_VARIANCE
