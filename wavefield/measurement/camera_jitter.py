"""How far cameras move against each other from frame to frame, and how uncertain that makes the water.

A camera that shakes moves its whole picture: an error that all nodes share, of which noise that is measured
from place to place knows nothing. Part of it shows, in what is left of the cameras' displacements on the mean
over the field: across the line on which they stand for each of them, along it for three or more in one
combination; another one lifts all of the water in one frame and lets it down in the next. Nothing says whose
it is; so all are thought to move alike, as far as explains what shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[Any]

_NODES = 400  # evenly over the field: motion that all share needs no more
_MIN_FREEDOM = 0.05  # of the variance of what moves: less is left over of it where the cameras cannot tell it
_FEW = 50  # nodes: less tell nothing


def line_of(centres: Sequence[Float]) -> Float:
    """Direction of the line along which cameras stand.

    With centres (3,), metres; returns (2,): Horizontal unit vector.

    Examples
    --------
    >>> line_of([np.array([-2.0, 0, 4]), np.array([2.0, 0.0, 4]), np.array([0.0, 0, 4])]).tolist()
    [1.0, 0.0]
    """
    place = np.array([c[:2] for c in centres])
    x, y = np.linalg.svd(place - place.mean(axis=0))[2][0]
    sign = 1.0 if (x, y) > (0.0, 0.0) else -1.0
    return np.array([x, y]) * sign + 0.0


def left_over(
    jacobian: Float, moved: Float, weight: Float, good: NDArray[np.bool_], line: Float
) -> tuple[Float, tuple[float, float]]:
    """What the cameras' displacements leave on the mean over the field, and how far cameras move for it.

    A motion m of the pictures leaves M m, M = 1 - J (J^T W J)^-1 J^T W. Of motions of variance s^2 along one
    direction e of each picture, E|e^T M m|^2 = s^2 tr(P P^T) with P = e^T M e: s^2 follows from one step, and
    where a direction leaves nothing (two cameras, along the line) from the other.

    With jacobian (2N, 3, ny, nx), px per metre; moved, weight (2N, ny, nx), px; good (ny, nx); line (2,);
    returns left (2N,): Median of the residuals over the field, px.
    """
    rows = len(moved)
    places = np.flatnonzero(good.ravel())
    if len(places) < _FEW or rows < 4:
        return np.zeros(rows), (0.0, 0.0)
    some = places[:: max(1, len(places) // _NODES)]
    J = np.moveaxis(jacobian.reshape(rows, 3, -1)[:, :, some], -1, 0)
    back = np.swapaxes(J, 1, 2) * weight.reshape(rows, -1)[:, some].T[:, None, :]
    leaves = np.eye(rows) - J @ np.linalg.solve(back @ J, back)
    left = np.median(np.einsum("nij,nj->ni", leaves, moved.reshape(rows, -1)[:, some].T), axis=0)
    M, J = leaves.mean(axis=0), J.mean(axis=0)
    found = []
    for e in _directions(J, line):
        P = e.T @ M @ e
        freedom = float(np.trace(P @ P.T))
        found.append((float(np.sum(np.square(e.T @ left))), freedom))
    enough = [freedom > _MIN_FREEDOM * rows / 2 for _, freedom in found]
    size = [
        np.sqrt(square / freedom) if ok else 0.0 for (square, freedom), ok in zip(found, enough, strict=True)
    ]
    if not enough[0]:
        size[0] = size[1]
    return left, (float(size[0]), float(size[1]))


def of_the_water(
    jacobian: Float, weight: Float, good: NDArray[np.bool_], line: Float, size: tuple[float, float]
) -> Float:
    """Variance of the water's displacement from pictures that move.

    With size (float, float), px; returns (3,): Of dx, dy, dz, square metres, in the middle of the nodes that
    count.
    """
    places = np.flatnonzero(good.ravel())
    if not len(places) or not any(size):
        return np.zeros(3)
    some = places[:: max(1, len(places) // _NODES)]
    J = jacobian.reshape(len(jacobian), 3, -1)[:, :, some].mean(axis=2)
    W = weight.reshape(len(weight), -1)[:, some].mean(axis=1)
    G = np.linalg.solve((J.T * W) @ J, J.T * W)
    parts = [np.square(s) * np.square(G @ e).sum(axis=1) for s, e in zip(size, _directions(J, line))]
    return np.asarray(parts[0] + parts[1])


def of_elevation(heights: Float, lengths: Float, least: float = 0.0) -> float:
    """Variance of the elevation of all pairs of cameras, from how it differs between them over the field.

    With the pictures of P + 1 cameras moved alike along the line, pair p is off by (m_p - m_0) / L_p; all
    pairs together, weighed by L^2, by sum h_p (m_p - m_0) / L_p.

    With heights (P,), metres; lengths (P,).

    Examples
    --------
    >>> of_elevation(np.array([6.0, 0.0]), np.array([1.0, -1.0]))
    3.0
    """
    of, all_pairs = _of_pairs(lengths)
    rest = np.eye(len(of)) - all_pairs
    shows = float(np.sum(np.square(rest @ heights)) / max(np.sum(np.square(rest @ of)), 1e-30))
    return max(shows, least) * float(np.sum(np.square(all_pairs @ of)))


def _of_pairs(lengths: Float) -> tuple[Float, Float]:
    """What motion of the pictures along the line makes of each pair's elevation, (P, P + 1), the reference
    first, and the weights of the pairs."""
    L = np.asarray(lengths, float)
    return np.column_stack([-1.0 / L, np.diag(1.0 / L)]), np.square(L) / np.sum(np.square(L))


def motion_for(level: float, lengths: Float) -> float:
    """Motion of every camera's picture on the water along the line that moves the level of z by so much.

    With level, metres; lengths (P,); returns Standard deviation, metres.

    Examples
    --------
    >>> round(motion_for(1.0, np.array([1.0, -1.0])), 3)
    1.414
    """
    of, all_pairs = _of_pairs(lengths)
    return level / float(np.sqrt(np.sum(np.square(all_pairs @ of))))


def unsteady(levels: Sequence[float], turn: float) -> float:
    """How far the mean level of the water moves as no water does, from frame to frame.

    Of levels that err by s each, the fifth difference errs by sqrt(252) s; of a wave whose phase turns by p
    from frame to frame it keeps (2 sin(p/2))^5, a hundredth at p = .4: so much of the levels' own amplitude
    is taken off.

    With levels, metres; turn, rad; returns Standard deviation of each, metres, that explains their fifth
    difference.

    Examples
    --------
    >>> unsteady([0, 1, 4, 9, 16, 25], 0.5)
    0.0
    >>> round(unsteady([0, 0, 1, 0, 0, 0], 0.5), 2)
    0.63
    """
    waves = 2.0 * float(np.var(levels)) * (2.0 * np.sin(0.5 * min(turn, np.pi))) ** 10
    return float(np.sqrt(max(float(np.diff(levels, 5)[0]) ** 2 - waves, 0.0) / 252.0))


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
