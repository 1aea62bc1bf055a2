"""The joint fit: all cameras and all poses of the target at once (bundle adjustment)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wavefield.calibration.observations import LENS, Geometry, Observations
from wavefield.rig.camera import Array
from wavefield.robust import robust_std

# terms of a model -> the columns of Geometry.lens they move; f (log of both focal lengths) and aspect (log of
# fx alone) are not columns themselves
TERMS: dict[str, tuple[str, ...]] = {
    "f": ("f",),
    "aspect": ("aspect",),
    "c": ("cx", "cy"),
    "k1": ("k1",),
    "k2": ("k2",),
    "p": ("p1", "p2"),
    "k3": ("k3",),
    "tilt": ("tau_x", "tau_y"),
}


def tilt_matrix(tau_x: complex, tau_y: complex) -> NDArray[np.complex128]:
    """Homography of a tilted sensor (OpenCV's), for real or complex angles.

    Parameters
    ----------
    tau_x, tau_y : float or complex
        Angles, radians.

    Returns
    -------
    ndarray, (3, 3)
    """
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    rot = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]], complex) @ np.array(
        [[1, 0, 0], [0, cx, sx], [0, -sx, cx]], complex
    )
    return np.array([[rot[2, 2], 0, -rot[0, 2]], [0, rot[2, 2], -rot[1, 2]], [0, 0, 1]]) @ rot


def project(lens: Array, points: Array) -> tuple[Array, Array, Array]:
    """Pixels of points in a camera's frame, with all derivatives.

    Parameters
    ----------
    lens : ndarray, (12,)
        `LENS`.
    points : ndarray, (n, 3)
        In the camera's frame, metres.

    Returns
    -------
    pixel : ndarray, (n, 2)
        Pixels.
    by_point : ndarray, (n, 2, 3)
        Derivatives with respect to the points, px per metre.
    by_lens : ndarray, (n, 2, 12)
        Derivatives with respect to `LENS`.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3, tau_x, tau_y, skew = lens
    zc = points[:, 2]
    a, b = points[:, 0] / zc, points[:, 1] / zc
    r2 = a * a + b * b
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    u = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    v = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    cross = slope * a * b + 2.0 * p1 * a + 2.0 * p2 * b
    by_tangent = np.stack(
        [
            np.stack([radial + slope * a * a + 2.0 * p1 * b + 6.0 * p2 * a, cross], -1),
            np.stack([cross, radial + slope * b * b + 6.0 * p1 * b + 2.0 * p2 * a], -1),
        ],
        -2,
    )
    # sensor: pixel = K . tilt(u, v)
    h = tilt_matrix(tau_x, tau_y).real
    uv1 = np.stack([u, v, np.ones_like(u)])
    n = h @ uv1
    x, y = n[0] / n[2], n[1] / n[2]
    K = np.array([[fx, skew], [0.0, fy]])
    pixel = np.stack([x, y], -1) @ K.T + (cx, cy)

    def through_tilt(d: Array) -> Array:  # numerators' derivative (3, n) -> (n, 2) pixels
        return np.stack([(d[0] - x * d[2]) / n[2], (d[1] - y * d[2]) / n[2]], -1) @ K.T

    one, nil = np.ones_like(u), np.zeros_like(u)
    by_u = through_tilt(h[:, :1] * one)
    by_v = through_tilt(h[:, 1:2] * one)
    by_uv = np.stack([by_u, by_v], -1)
    by_ab = by_uv @ by_tangent
    by_point = np.empty((len(points), 2, 3))
    by_point[..., :2] = by_ab / zc[:, None, None]
    by_point[..., 2] = -(by_ab[..., 0] * a[:, None] + by_ab[..., 1] * b[:, None]) / zc[:, None]
    by_lens = np.zeros((len(points), 2, len(LENS)))
    by_lens[:, 0, 0], by_lens[:, 1, 1] = x, y
    by_lens[:, 0, 2] = by_lens[:, 1, 3] = 1.0
    for column, du, dv in (
        (4, a * r2, b * r2),
        (5, a * r2**2, b * r2**2),
        (6, 2.0 * a * b, r2 + 2.0 * b * b),
        (7, r2 + 2.0 * a * a, 2.0 * a * b),
        (8, a * r2**3, b * r2**3),
    ):
        by_lens[..., column] = by_u * du[:, None] + by_v * dv[:, None]
    step = 1e-30  # complex step: exact
    for column, dh in (
        (9, tilt_matrix(tau_x + 1j * step, tau_y).imag / step),
        (10, tilt_matrix(tau_x, tau_y + 1j * step).imag / step),
    ):
        by_lens[..., column] = through_tilt(dh @ uv1)
    by_lens[:, 0, 11] = y
    by_lens[:, 1, 11] = nil
    return pixel, by_point, by_lens


def _turn(rotation: Array, vector: Array) -> tuple[Array, Array]:
    """Rotation . exp(vector), and its derivatives (3, 3, 3) with respect to the vector."""
    R, jacobian = cv2.Rodrigues(np.asarray(vector, float))
    derivative = np.asarray(jacobian, float).reshape(3, 3, 3)
    return rotation @ np.asarray(R, float), rotation @ derivative


@dataclass(frozen=True)
class Layout:
    """Which parameter moves what.

    Parameters
    ----------
    names : tuple of str
        One per parameter, for people.
    lens : tuple of tuple of (int, str)
        Per camera, (parameter, moved term).
    camera : tuple of int
        Per camera, the first of its six parameters of pose (rotation vector, translation).
    pose : tuple of tuple of (int, int)
        Per pose of the target, (parameter, which of the six); none for the pose that defines the frame.
    """

    names: tuple[str, ...]
    lens: tuple[tuple[tuple[int, str], ...], ...]
    camera: tuple[int, ...]
    pose: tuple[tuple[tuple[int, int], ...], ...]


def layout(
    observations: Observations, models: Sequence[Sequence[str]], reference: int, flat: Sequence[int] = ()
) -> Layout:
    """Lay out the parameters of the joint fit.

    Parameters
    ----------
    observations : Observations
        Cameras and poses.
    models : sequence of sequence of str
        Per camera, the `TERMS` that are free.
    reference : int
        The pose that defines the frame: not moved.
    flat : sequence of int
        Further poses on the plane z = 0, which turn about z and shift along it only.

    Returns
    -------
    Layout
    """
    names: list[str] = []
    lens, camera, pose = [], [], []
    for c, name in enumerate(observations.cameras):
        moved = [column for term in models[c] for column in TERMS[term]]
        lens.append(tuple((len(names) + k, column) for k, column in enumerate(moved)))
        names += [f"{name} {column}" for column in moved]
        camera.append(len(names))
        names += [f"{name} {what}" for what in ("R1", "R2", "R3", "T1", "T2", "T3")]
    seen = set(np.unique(observations.pose).tolist())
    for p, name in enumerate(observations.poses):
        free = [] if p == reference or p not in seen else [2, 3, 4] if p in flat else list(range(6))
        pose.append(tuple((len(names) + k, which) for k, which in enumerate(free)))
        names += [f"{name} {('R1', 'R2', 'R3', 'x', 'y', 'z')[which]}" for which in free]
    return Layout(tuple(names), tuple(lens), tuple(camera), tuple(pose))


def moved(start: Geometry, plan: Layout, x: Array) -> Geometry:
    """The geometry at given parameters, counted from a start.

    Parameters
    ----------
    start : Geometry
        Where all parameters are zero.
    plan : Layout
        What they mean.
    x : ndarray, (p,)
        Parameters.

    Returns
    -------
    Geometry
    """
    lens, R, T = start.lens.copy(), start.R.copy(), start.T.copy()
    pose_R, pose_t = start.pose_R.copy(), start.pose_t.copy()
    for c, columns in enumerate(plan.lens):
        for k, column in columns:
            if column == "f":
                lens[c, :2] *= np.exp(x[k])
            elif column == "aspect":
                lens[c, 0] *= np.exp(x[k])
            else:
                lens[c, LENS.index(column)] += x[k]
        k = plan.camera[c]
        R[c] = _turn(R[c], x[k : k + 3])[0]
        T[c] += x[k + 3 : k + 6]
    for p, moves in enumerate(plan.pose):
        step = np.zeros(6)
        for k, which in moves:
            step[which] = x[k]
        pose_R[p] = _turn(pose_R[p], step[:3])[0]
        pose_t[p] += step[3:]
    return replace(start, lens=lens, R=R, T=T, pose_R=pose_R, pose_t=pose_t)


def predict(geometry: Geometry, observations: Observations) -> Array:
    """Pixels predicted by a geometry.

    Parameters
    ----------
    geometry : Geometry
        Cameras, poses and nodes.
    observations : Observations
        What is to be predicted.

    Returns
    -------
    ndarray, (n, 2)
        Pixels; NaN behind a camera.
    """
    o = observations
    world = geometry.world(o)
    pixel = np.empty((len(o), 2))
    for c, size in enumerate(o.sizes):
        rows = o.camera == c
        pixel[rows] = np.stack(geometry.camera(c, size).project(*world[rows].T), axis=-1)
    return pixel


def linearised(
    start: Geometry, plan: Layout, x: Array, observations: Observations
) -> tuple[Array, Array, Array]:
    """Pixels predicted at given parameters, with derivatives.

    Parameters
    ----------
    start, plan, x
        As `moved`.
    observations : Observations
        What is to be predicted.

    Returns
    -------
    pixel : ndarray, (n, 2)
        Pixels.
    jacobian : ndarray, (n, 2, p)
        Derivatives with respect to the parameters.
    by_node : ndarray, (n, 2, 3)
        Derivatives with respect to the nodes' offsets, px per metre.
    """
    o = observations
    now = moved(start, plan, x)
    local = (o.plan + now.offset)[o.node]
    world = now.world(o)
    pixel, by_node = np.empty((len(o), 2)), np.empty((len(o), 2, 3))
    J = np.zeros((len(o), 2, len(plan.names)))
    for c in range(len(o.cameras)):
        rows = np.flatnonzero(o.camera == c)
        if not rows.size:
            continue
        R = now.R[c]
        pixel[rows], by_point, by_lens = project(now.lens[c], world[rows] @ R.T + now.T[c])
        for k, column in plan.lens[c]:
            if column in ("f", "aspect"):
                J[rows, :, k] = by_lens[..., 0] * now.lens[c, 0]
                if column == "f":
                    J[rows, :, k] += by_lens[..., 1] * now.lens[c, 1]
            else:
                J[rows, :, k] = by_lens[..., LENS.index(column)]
        k = plan.camera[c]
        _, turn = _turn(start.R[c], x[k : k + 3])
        for i in range(3):
            J[rows, :, k + i] = np.einsum("nij,nj->ni", by_point, world[rows] @ turn[i].T)
        J[rows, :, k + 3 : k + 6] = by_point
        by_world = by_point @ R
        by_node[rows] = by_world @ now.pose_R[o.pose[rows]]
        for p in np.unique(o.pose[rows]):
            columns = plan.pose[p]
            if not columns:
                continue
            here = o.pose[rows] == p
            step = np.zeros(6)
            for k, which in columns:
                step[which] = x[k]
            _, turn = _turn(start.pose_R[p], step[:3])
            for k, which in columns:
                if which < 3:
                    J[rows[here], :, k] = np.einsum(
                        "nij,nj->ni", by_world[here], local[rows[here]] @ turn[which].T
                    )
                else:
                    J[rows[here], :, k] = by_world[here][:, :, which - 3]
    return pixel, J, by_node


class Whitener:
    """Errors of the target's nodes as noise shared by all views of a node.

    A node that is off by an unknown e (standard deviation ``target_std`` per axis) shifts its image in
    every view by B e. Residuals of one node then have the covariance C = I + target_std^2 B B^T (in units
    of their own uncertainty); multiplied by C^(-1/2) they are independent again. That is the same as
    solving for all e with a prior, at the cost of a fit without them.

    Parameters
    ----------
    node : ndarray of int, (n,)
        Node of each observation.
    by_node : ndarray, (n, 2, 3)
        B, already divided by the observations' uncertainty.
    target_std : float
        Standard deviation of the nodes' offsets per axis, metres.
    """

    def __init__(self, node: NDArray[np.int64], by_node: Array, target_std: float):
        n, count = len(node), int(node.max()) + 1
        B = by_node.reshape(2 * n, 3) * target_std
        columns = 3 * np.repeat(node, 2)[:, None] + np.arange(3)
        self._B = sparse.csr_array(
            (B.ravel(), columns.ravel(), np.arange(0, 6 * n + 1, 3)), shape=(2 * n, 3 * count)
        )
        self._Bt = self._B.T.tocsr()
        inner = np.zeros((count, 3, 3))
        np.add.at(inner, np.repeat(node, 2), B[:, :, None] * B[:, None, :])
        size, axes = np.linalg.eigh(inner)
        size = np.maximum(size, 0.0)
        # C^(-1/2) = 1 - B Q B^T on the three directions that B spans
        root = np.sqrt(1.0 + size)
        self._half = _blocks((axes * (1.0 / (root * (1.0 + root)))[:, None, :]) @ axes.transpose(0, 2, 1))
        self._gain = target_std * _blocks((axes / (1.0 + size)[:, None, :]) @ axes.transpose(0, 2, 1))

    def __call__(self, rows: Array) -> Array:
        """Make residuals (2n,) or Jacobian rows (2n, p) independent.

        Parameters
        ----------
        rows : ndarray, (2n,) or (2n, p)
            In units of the observations' own uncertainty.

        Returns
        -------
        ndarray of the same shape
        """
        return rows - self._B @ (self._half @ (self._Bt @ rows))

    def offsets(self, residual: Array) -> Array:
        """Most probable offsets of the nodes.

        Parameters
        ----------
        residual : ndarray, (2n,)
            Observed less predicted for a perfect target, in units of the uncertainty.

        Returns
        -------
        ndarray, (highest node + 1, 3)
            Metres; zero for nodes that were not seen.
        """
        return (self._gain @ (self._Bt @ residual)).reshape(-1, 3)


def _blocks(matrices: Array) -> sparse.csr_array:
    """Block-diagonal matrix of 3 x 3 blocks."""
    n = len(matrices)
    columns = np.broadcast_to(3 * np.arange(n)[:, None, None] + np.arange(3), (n, 3, 3))
    return sparse.csr_array(
        (matrices.ravel(), columns.ravel(), np.arange(0, 9 * n + 1, 3)), shape=(3 * n, 3 * n)
    )


@dataclass(frozen=True)
class Fit:
    """Result of a joint fit.

    Parameters
    ----------
    geometry : Geometry
        Cameras, poses and node offsets.
    layout : Layout
        The parameters.
    covariance : ndarray, (p, p)
        Of the parameters, scaled by the observed scatter.
    residual : ndarray, (n, 2)
        Observed less predicted, px.
    scale : float
        Scatter of the residuals over their stated uncertainty.
    chi2 : float
        Robust sum of squares of the independent residuals, in units of the stated uncertainty.
    steps : int
        Evaluations of the Jacobian.
    """

    geometry: Geometry
    layout: Layout
    covariance: Array
    residual: Array
    scale: float
    chi2: float
    steps: int


def fit(
    observations: Observations,
    start: Geometry,
    models: Sequence[Sequence[str]],
    reference: int,
    flat: Sequence[int] = (),
    target_std: float = 0.0,
    noise_scale: float | None = None,
) -> Fit:
    """Fit cameras and poses to all observations.

    Parameters
    ----------
    observations : Observations
        What was seen.
    start : Geometry
        Near enough: within a few degrees and per cent.
    models : sequence of sequence of str
        Per camera, the `TERMS` that are free.
    reference, flat
        As `layout`.
    target_std : float, default 0
        Standard deviation of the nodes' offsets per axis, metres; 0 takes the target as perfect.
    noise_scale : float, optional
        Scatter over stated uncertainty, where Huber's loss bends at four times it; measured if left out.

    Returns
    -------
    Fit

    Notes
    -----
    Levenberg-Marquardt with the analytic Jacobian and Huber's loss at four standard deviations.
    """
    o = observations
    plan = layout(o, models, reference, flat)
    start = replace(start, offset=np.zeros_like(start.offset))
    inverse = 1.0 / np.repeat(o.std, 2)
    whitener: Whitener | None = None

    def residual(x: Array) -> Array:
        r = (predict(moved(start, plan, x), o) - o.pixel).ravel() * inverse
        return whitener(r) if whitener else r

    def with_jacobian(x: Array) -> tuple[Array, Array]:
        pixel, J, _ = linearised(start, plan, x, o)
        r, J = (pixel - o.pixel).ravel() * inverse, J.reshape(2 * len(o), -1) * inverse[:, None]
        return (whitener(r), whitener(J)) if whitener else (r, J)

    x = np.zeros(len(plan.names))
    steps = 0
    # the bend depends on the scatter, and the whitening on the geometry: approach, then settle
    for tolerance in (1e-2, 1e-7):
        if target_std > 0.0:
            whitener = Whitener(o.node, linearised(start, plan, x, o)[2] / o.std[:, None, None], target_std)
        x, bend, count = minimise(
            residual, with_jacobian, x, 4.0 * noise_scale if noise_scale else None, tolerance
        )
        steps += count
    r, J = with_jacobian(x)
    # exact points leave no scatter at all; a covariance of nothing helps no one
    scale = max(robust_std(r) * np.sqrt(len(r) / max(len(r) - len(x), 1)), 1e-6)
    weight = np.minimum(1.0, bend / np.maximum(np.abs(r), 1e-300))
    normal = J.T @ (weight[:, None] * J)
    d = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    covariance = (
        scale**2 * np.linalg.pinv(normal * np.outer(d, d), rcond=1e-15, hermitian=True) * np.outer(d, d)
    )
    geometry = moved(start, plan, x)
    predicted = predict(moved(start, plan, x), o)
    if whitener:
        miss = (o.pixel - predicted).ravel() * inverse
        offset = np.zeros_like(start.offset)
        found = whitener.offsets(miss)
        offset[: len(found)] = found
        geometry = replace(geometry, offset=offset)
        predicted = predict(geometry, o)
    return Fit(geometry, plan, covariance, o.pixel - predicted, float(scale), huber(r, bend), steps)


def huber(r: Array, bend: float) -> float:
    """Sum of squares, growing linearly beyond the bend.

    Parameters
    ----------
    r : ndarray
        Residuals.
    bend : float
        Where the loss turns from square to linear.

    Returns
    -------
    float
    """
    size = np.abs(r)
    return float(np.sum(np.where(size <= bend, size * size, bend * (2.0 * size - bend))))


def minimise(
    residual: Callable[[Array], Array],
    with_jacobian: Callable[[Array], tuple[Array, Array]],
    x: Array,
    bend: float | None,
    tolerance: float,
) -> tuple[Array, float, int]:
    """Least squares with Huber's loss, by Levenberg and Marquardt.

    Parameters
    ----------
    residual : callable
        x to residuals (m,).
    with_jacobian : callable
        x to residuals and Jacobian (m, p).
    x : ndarray, (p,)
        Start.
    bend : float, optional
        Of the loss; four times the robust scatter at each step, if left out.
    tolerance : float
        Stop when a step promises to lower the sum of squares by less than this share.

    Returns
    -------
    x : ndarray, (p,)
        Minimum.
    bend : float
        As used last.
    steps : int
        Jacobians computed.

    Notes
    -----
    Normal equations of scaled parameters, p x p: thousands of observations and some seventy parameters make
    `scipy.optimize.least_squares`, which decomposes the whole Jacobian at each step, thirty times slower for
    the same minimum (a test holds the two against each other). Steps end where the gradient does, so the
    squared condition number costs steps at most, not accuracy.
    """
    damping = 1e-4
    diagonal = np.zeros_like(x)
    steps = 0
    scale = 0.0
    while steps < 60:
        r, J = with_jacobian(x)
        steps += 1
        scale = bend or max(4.0 * robust_std(r), 1e-9)
        cost = huber(r, scale)
        weight = np.minimum(1.0, scale / np.maximum(np.abs(r), 1e-300))
        gradient = J.T @ (weight * r)
        normal = J.T @ (weight[:, None] * J) if (weight < 1.0).any() else J.T @ J
        diagonal = np.maximum(diagonal, np.sqrt(np.diag(normal)))
        d = np.where(diagonal > 0.0, diagonal, 1.0)
        scaled, slope = normal / np.outer(d, d), gradient / d
        while True:
            step = -np.linalg.solve(scaled + damping * np.eye(len(x)), slope)
            promise = -(2.0 * slope @ step + step @ scaled @ step)
            if promise <= tolerance * cost or cost < 1e-24 * len(r):
                return x + step / d if promise > 0.0 else x, scale, steps
            trial = residual(x + step / d)
            gain = (cost - huber(trial, scale)) / promise
            if gain > 0.0 and np.isfinite(gain):
                x = x + step / d
                damping = max(damping * max(1.0 / 30.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-12)
                break
            damping *= 10.0
            if damping > 1e8:
                return x, scale, steps
    return x, scale, steps
