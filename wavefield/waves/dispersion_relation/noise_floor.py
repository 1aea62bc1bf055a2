"""Level of the noise of a spectrum at every line and wave vector, from where no free waves are."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.waves.dispersion_relation.current_scan import WavenumberPlane

Array = NDArray[Any]

OUTER = 0.8  # of the largest k along the axes: waves this short are weak on most lines
_RING_CELLS = 1.5  # width of a ring of wavenumbers


def noise_level(energy: Array, plane: WavenumberPlane, nyquist_k: float) -> Array:
    """Level of the noise, a function of the frequency times a function of the wavenumber.

    Along frequency: the median over the shortest waves. Along k: the level, over all lines, of what a ring
    holds in units of that; free waves are on few of them. Errors of measured displacements are independent
    from step to step and smooth over a matching window, so that their spectrum is such a product.

    With energy (lines, cells); nyquist_k, rad/m; returns (lines, cells).
    """
    outer = plane.k > OUTER * nyquist_k
    if not outer.any():
        return np.zeros(energy.shape, np.float32)
    along_omega = np.median(energy[:, outer], axis=1)
    ring = np.floor(plane.k / (_RING_CELLS * plane.cell)).astype(int)
    ring = np.minimum(ring, ring[outer].min())  # the shortest waves are one ring
    units = np.where(along_omega > 0, along_omega, np.inf)[:, None]
    order = np.argsort(ring, kind="stable")
    edges = np.searchsorted(ring[order], np.arange(ring.max() + 2))
    levels = np.array(
        [_mean_of_noise(energy[:, order[a:b]] / units) if b > a else 0.0 for a, b in pairwise(edges)]
    )
    return np.asarray(along_omega[:, None] * levels[ring], np.float32)


def _mean_of_noise(values: Array) -> float:
    # of values distributed as chi-squared but for some larger ones: mean = median + variance / (3 mean), the
    # variance from the lower quartile, which waves do not change
    low, middle = np.quantile(values, [0.25, 0.5])
    std = (middle - low) / 0.6745
    return float(middle + std**2 / (3 * middle)) if middle > 0 else 0.0
