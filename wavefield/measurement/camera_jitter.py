"""How far cameras move against each other from frame to frame, and how uncertain that makes the water.

A camera that shakes moves its whole picture: an error common to all nodes, which noise that is measured from
place to place does not contain. Part of it shows in the mean residuals of the cameras' displacements over the
field: across the row of cameras for each of them, along it for three or more in one combination; another one
lifts all of the water in one frame and lowers it in the next. Which camera it is cannot be determined; so all
are assumed to move alike, as far as explains what shows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating]

_SAMPLED_NODES = 400  # evenly over the field: enough for motion that is common to all
_MIN_FREEDOM = 0.05  # of the variance of the motion that residuals must show
_MIN_NODES = 50  # for a mean over the field
_PARTS = 8  # of the field, whose residuals show by how much the median is off by chance


def row_direction(centres: Sequence[Float]) -> Float:
    """Horizontal unit vector (2,), not towards negative x, along a row of cameras with these centres (3,)."""
    place = np.array([c[:2] for c in centres])
    x, y = np.linalg.svd(place - place.mean(axis=0))[2][0]
    sign = 1.0 if (x, y) > (0.0, 0.0) else -1.0
    return np.array([x, y]) * sign + 0.0


def mean_residuals(
    jacobian: Float, moved: Float, weight: Float, measured: NDArray[np.bool_], line: Float
) -> tuple[Float, tuple[float, float]]:
    """Median residuals (2N,) over the field, px, and the motion along and across the line that explains them.
    With jacobian (2N, 3, ny, nx), px per metre; moved, px, and its weight (2N, ny, nx); line (2,).
    """
    rows = len(moved)
    places = np.flatnonzero(measured.ravel())
    if len(places) < _MIN_NODES or rows < 4:
        return np.zeros(rows), (0.0, 0.0)
    sample = places[:: max(1, len(places) // _SAMPLED_NODES)]
    J = np.moveaxis(jacobian.reshape(rows, 3, -1)[:, :, sample], -1, 0)
    back = np.swapaxes(J, 1, 2) * weight.reshape(rows, -1)[:, sample].T[:, None, :]
    # a motion m of the pictures leaves M m, M = 1 - J (J^T W J)^-1 J^T W; with variance s^2 along a direction
    # e of each picture E|e^T M m|^2 = s^2 tr(P P^T), P = e^T M e, from which s^2 follows
    leaves = np.eye(rows) - J @ np.linalg.solve(back @ J, back)
    rest = np.einsum("nij,nj->ni", leaves, moved.reshape(rows, -1)[:, sample].T)
    left = np.median(rest, axis=0)
    parts = np.array([np.median(part, axis=0) for part in np.array_split(rest, _PARTS)])
    M = leaves.mean(axis=0)
    size = [0.0, 0.0]
    determined = [False, False]
    for k, e in enumerate(_directions(J.mean(axis=0), line)):
        P = e.T @ M @ e
        freedom = float(np.trace(P @ P.T))
        determined[k] = freedom > _MIN_FREEDOM * rows / 2
        if determined[k]:
            chance = float(np.sum(np.var(parts @ e, axis=0, ddof=1))) / _PARTS
            size[k] = float(np.sqrt(max(float(np.sum(np.square(e.T @ left))) - chance, 0.0) / freedom))
    return left, (size[0] if determined[0] else size[1], size[1])


def displacement_variance(
    jacobian: Float, weight: Float, measured: NDArray[np.bool_], line: Float, size: tuple[float, float]
) -> Float:
    """Variance of dx, dy, dz of the water, (3,), square metres, from pictures that move by size, px.
    It is that in the middle of the measured nodes; other arguments are as in `mean_residuals`.
    """
    places = np.flatnonzero(measured.ravel())
    if not len(places) or not any(size):
        return np.zeros(3)
    sample = places[:: max(1, len(places) // _SAMPLED_NODES)]
    J = jacobian.reshape(len(jacobian), 3, -1)[:, :, sample].mean(axis=2)
    W = weight.reshape(len(weight), -1)[:, sample].mean(axis=1)
    G = np.linalg.solve((J.T * W) @ J, J.T * W)
    along, across = (np.square(s) * np.square(G @ e).sum(axis=1) for s, e in zip(size, _directions(J, line)))
    return np.asarray(along + across)


def elevation_variance(heights: Float, lengths: Float, least: float = 0.0) -> float:
    """Variance, m^2, of the elevation of all pairs from its differences between pairs: heights (P,), metres.
    Pair p is off by (m_p - m_0) / L_p, with lengths L (P,) of the parallax; least is the least variance of m.
    """
    by_pair, by_all = _elevation_errors(lengths)
    rest = np.eye(len(by_pair)) - by_all
    variance = float(np.sum(np.square(rest @ heights)) / max(np.sum(np.square(rest @ by_pair)), 1e-30))
    return max(variance, least) * float(np.sum(np.square(by_all @ by_pair)))


def _elevation_errors(lengths: Float) -> tuple[Float, Float]:
    """Elevation of each pair per motion of each picture along the line, (P, P + 1); weights of the pairs."""
    L = np.asarray(lengths, float)
    return np.column_stack([-1.0 / L, np.diag(1.0 / L)]), np.square(L) / np.sum(np.square(L))


def motion_for_level(level: float, lengths: Float) -> float:
    """Std of each camera's picture on the water along the line that gives the level of z this std; metres."""
    by_pair, by_all = _elevation_errors(lengths)
    return level / float(np.sqrt(np.sum(np.square(by_all @ by_pair))))


def level_jitter(levels: Sequence[float], phase: float, times: Float | None = None) -> float:
    """Std of six mean levels of the water that no wave explains, metres; uneven times are in intervals.
    The fifth difference of errors s is sqrt(252) s; of a wave of phase p per frame it keeps (2 sin(p/2))^5.
    """
    waves = 2.0 * float(np.var(levels)) * (2.0 * np.sin(0.5 * min(phase, np.pi))) ** 10
    if times is None:
        return float(np.sqrt(max(float(np.diff(levels, 5)[0]) ** 2 - waves, 0.0) / 252.0))
    weights = 120.0 / np.prod(np.subtract.outer(times, times) + np.eye(6), axis=1)
    return float(np.sqrt(max(float(weights @ levels) ** 2 - waves, 0.0) / float(weights @ weights)))


def _directions(J: Float, line: Float) -> tuple[Float, Float]:
    """Unit vectors of every camera's picture along the line and across it, each (2N, N)."""
    out = []
    for e in (line, np.array([-line[1], line[0]])):
        vectors = J[:, :2] @ e
        columns = np.zeros((len(J), len(J) // 2))
        for n in range(len(J) // 2):
            own = vectors[2 * n : 2 * n + 2]
            columns[2 * n : 2 * n + 2, n] = own / np.hypot(*own)
        out.append(columns)
    return out[0], out[1]
