"""How noisy each camera's displacements are, from how the cameras differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

Float = NDArray[Any]

MEDIAN_CHI2 = 2.0 * float(gammaincinv(0.5, 0.5))  # of chi^2 of one degree of freedom
MIN_RELATIVE_FREEDOM = 0.1  # of the best determined combination of cameras: others keep the common noise
MIN_FREEDOM = 0.05  # part of a row's variance in its residual
MIN_FACTOR = 0.2  # of the common one


def noise_of_each(jacobian: Float, moved: Float, noise: Float, weight: Float) -> Float:
    """Factor on the noise of each camera, (N,), from the residuals of its displacements (Helmert 1907).
    With jacobian (n, 2N, 3), px per metre; moved (n, 2N), px; noise (n, 2N), px^2; weight (n, 2N), px^-2.
    """
    count, rows, _ = jacobian.shape
    if rows < 4 or not count:
        raise ValueError(f"noise needs two cameras and a node; got {rows // 2} cameras and {count} nodes")
    back = np.swapaxes(jacobian, 1, 2) * weight[:, None, :]
    # r = M dX has the variance sum_j M_ij^2 f_j noise_j in row i, M = 1 - J (J^T W J)^-1 J^T W: linear
    # equations for the factors f, with the median of r^2 in place of its mean; two cameras have one redundant
    # combination, and then one factor
    left = np.eye(rows) - jacobian @ np.linalg.solve(back @ jacobian, back)
    parts = np.square(left) * noise[:, None, :]
    expected = parts.sum(axis=2)
    free = np.median(expected / noise, axis=0)
    determined = free > MIN_FREEDOM
    if not determined.any():
        return np.ones(rows // 2)
    rest = np.square(np.einsum("nij,nj->ni", left, moved))
    found = np.median(rest[:, determined] / expected[:, determined], axis=0) / MEDIAN_CHI2
    of_each = np.median(parts[:, determined] / expected[:, determined, None], axis=0)
    of_each = of_each[:, ::2] + of_each[:, 1::2]
    of_each /= of_each.sum(axis=1, keepdims=True)
    root = np.sqrt(free[determined])
    common = float(np.sum(free[determined] * found) / np.sum(free[determined]))
    more = np.linalg.lstsq(of_each * root[:, None], (found - common) * root, rcond=MIN_RELATIVE_FREEDOM)[0]
    return np.asarray(np.maximum(common + more, MIN_FACTOR * common))


def own_noise(steps: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Factor on the noise of each camera relative to that of all: the median over steps.
    Cameras that err alike seem less noisy than they are: what others have more is shared out, the mean is 1.
    """
    names = sorted({name for step in steps for name in step})
    found = {name: max(1.0, float(np.median([s[name] for s in steps if name in s]))) for name in names}
    mean = float(np.mean([*found.values()])) if found else 1.0
    return {name: factor / mean for name, factor in found.items()}
