"""Values for missing nodes from those around them in space and time."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, sparse
from scipy.sparse import linalg

Array = NDArray[Any]

# second differences along x, along y and across, whose squares a thin plate's bending energy sums
_STENCILS = (
    (((0, -1), 1.0), ((0, 0), -2.0), ((0, 1), 1.0)),
    (((-1, 0), 1.0), ((0, 0), -2.0), ((1, 0), 1.0)),
    (((0, 0), 2**0.5), ((0, 1), -(2**0.5)), ((1, 0), -(2**0.5)), ((1, 1), 2**0.5)),
)

_WEIGHTS = (15 / 20, -6 / 20, 1 / 20)  # of the steps at 1, 2, 3: exact for polynomials of fifth degree
IN_TIME = len(_WEIGHTS)  # steps before and after that a missing value depends on
FLOOR = 1e-8  # of the largest power of a ring: the range in which a noise-free field is still interpolated
ITERATIONS = 12  # of conjugate gradients: with a fifth of the nodes missing at random more change nothing
_LAG = 2  # nodes between the values of a fourth difference
_PLATE_ERROR = (1.0, -4.0, 6.0, -4.0, 1.0)  # grows with k^4 as the error of the thin plate


def fill_nodes(block: Array, missing: NDArray[np.bool_]) -> Array:
    """Fill the missing nodes of the steps (steps, ny, nx) that are not missing as a whole.
    Steps are made smooth, then what the steps around leave: errors in space and in time multiply.
    """
    holes = ~np.isfinite(block) & ~missing[:, None, None]
    out = block.copy()
    alone = {}
    for t in np.flatnonzero(holes.any(axis=(1, 2))).tolist():
        alone[t] = block[t].copy()
        alone[t][holes[t]] = out[t][holes[t]] = most_probable(block[t], holes[t])
    for t, field in alone.items():
        near = slice(t - IN_TIME, t + IN_TIME + 1)
        if near.start < 0 or near.stop > len(block) or missing[near].any():
            continue
        guess = np.zeros(field.shape)
        for distance, weight in enumerate(_WEIGHTS, 1):
            for other in (t - distance, t + distance):
                guess += weight * alone.get(other, block[other])
        guess *= _agreement(field, guess)
        out[t][holes[t]] = guess[holes[t]] + most_probable(block[t] - guess, holes[t])
    return out


def fill_error(block: Array) -> float:
    """Standard deviation of `fill_nodes` at the middle of 2 `IN_TIME` + 1 steps; NaN where it has no holes.
    It is measured on nodes that are there, in holes of the same shapes half a field away.
    """
    holes = ~np.isfinite(block)
    ny, nx = holes.shape[1:]
    elsewhere = np.roll(holes, (ny // 2, nx // 2), (1, 2))  # at all steps: a hole stays for some of them
    known = elsewhere[IN_TIME] & ~holes[IN_TIME]
    if not known.any() or holes[IN_TIME].all():
        return np.nan
    holed = np.where(elsewhere, np.nan, block)
    missing = np.asarray(~np.isfinite(block).any(axis=(1, 2)))
    filled = fill_nodes(holed, missing)[IN_TIME]
    return float(np.sqrt(np.mean((filled - block[IN_TIME])[known] ** 2)))


def _agreement(field: Array, guess: Array) -> float:
    """Factor of a guess (ny, nx) that leaves least of the short waves of a field."""
    short = []
    for values in (field.astype(np.float64), guess):
        parts = [np.zeros(1)]
        for axis, n in enumerate(values.shape):
            if n > 4 * _LAG:
                starts = [np.arange(i * _LAG, n - (4 - i) * _LAG) for i in range(5)]
                moved = [weight * values.take(at, axis) for weight, at in zip(_PLATE_ERROR, starts)]
                parts.append(np.sum(moved, axis=0).ravel())
        short.append(np.concatenate(parts))
    power = float(short[1] @ short[1])
    return float(np.clip(short[0] @ short[1] / power, 0, 1)) if power > 0 else 0.0


def most_probable(field: Array, hole: NDArray[np.bool_]) -> Array:
    """Values of the missing nodes (hole.sum(),) of a field (ny, nx): conditional mean of a Gaussian process.
    Its spectrum S is that of the field with a thin plate in the holes, averaged over rings of wavenumber.
    With G = 1 - min(S) / S the values are the solution of x_m = G_mm x_m + G_mo x_o, by conjugate gradients.
    """
    plate = smoothest(field, hole)
    filled = np.where(hole, 0.0, field.astype(np.float64))
    filled[hole] = plate
    mean = filled.mean()
    filled -= mean
    ny, nx = hole.shape  # cosines of half a period and more
    distance = np.hypot(np.linspace(0, 1, ny)[:, None], np.linspace(0, 1, nx))
    ring = np.rint(distance * min(ny, nx)).astype(int)
    total = np.bincount(ring.ravel(), (fft.dctn(filled, norm="ortho") ** 2).ravel())
    power = total / np.maximum(np.bincount(ring.ravel()), 1)
    least = max(power[power > 0].min(initial=np.inf), FLOOR * power.max())
    if not np.isfinite(least) or least == power.max():
        return plate
    gain = (1 - least / np.maximum(power, least))[ring]

    def predicted(values: Array) -> Array:
        whole = np.zeros(hole.shape)
        whole[hole] = values
        return np.asarray(fft.idctn(gain * fft.dctn(whole, norm="ortho"), norm="ortho"))[hole]

    known = np.where(hole, 0.0, filled)
    right = fft.idctn(gain * fft.dctn(known, norm="ortho"), norm="ortho")[hole]
    x = plate - mean
    residual = right - (x - predicted(x))
    direction, size = residual, residual @ residual
    for _ in range(ITERATIONS):
        if not size > 0:
            break
        image = direction - predicted(direction)
        step = size / (direction @ image)
        x = x + step * direction
        residual = residual - step * image
        size, before = residual @ residual, size
        direction = residual + size / before * direction
    return np.asarray(x + mean)


def smoothest(field: Array, hole: NDArray[np.bool_]) -> Array:
    """Values of the missing nodes (hole.sum(),) of a field (ny, nx): least squares of second differences.
    A thin plate through the nodes around: waves of length L leave (2 pi r / L)^4 / 64 amid holes of radius r.
    """
    number = np.full(hole.shape, -1)
    number[hole] = np.arange(hole.sum())
    known = np.where(hole, 0.0, field.astype(np.float64))
    level = float(known[~hole].mean()) if not hole.all() else 0.0
    known = np.where(hole, 0.0, known - level)
    rows, columns, weights, right = [], [], [], []
    count = 0
    for stencil in _STENCILS:
        offsets = np.array([offset for offset, _ in stencil])
        low, high = -offsets.min(axis=0), offsets.max(axis=0)
        ny, nx = (n - a - b for n, a, b in zip(hole.shape, low, high))
        views = [
            (slice(low[0] + dy, low[0] + dy + ny), slice(low[1] + dx, low[1] + dx + nx)) for dy, dx in offsets
        ]
        touched = np.logical_or.reduce([hole[view] for view in views])
        equation = count + np.arange(touched.sum())
        constant = np.zeros(equation.size)
        for view, (_, weight) in zip(views, stencil):
            unknown = number[view][touched]
            inside = unknown >= 0
            rows.append(equation[inside])
            columns.append(unknown[inside])
            weights.append(np.full(inside.sum(), weight))
            constant += weight * known[view][touched]
        right.append(-constant)
        count += equation.size
    entries = np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))
    matrix = sparse.csc_array(entries, shape=(count, int(hole.sum())))
    normal = (matrix.T @ matrix).tocsc()
    return np.asarray(linalg.spsolve(normal, matrix.T @ np.concatenate(right)) + level)
