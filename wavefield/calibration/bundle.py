"""Bundle adjustment: fit all cameras and target poses together; estimate the covariance of the parameters.

The parameters x (p,) are steps from start values: lens terms of each camera, and a rotation vector and a
translation for each camera and for each free pose of the target. A node is a marked point of the target.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wavefield.calibration.observations import Geometry, Observations
from wavefield.rig.lens import LENS, Array, project
from wavefield.robust import robust_std

# Terms of a camera model, and the lens parameters that each one frees. `f` is the logarithm of both focal
# lengths, `aspect` that of fx alone; the others are columns of `Geometry.lens`.
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


def _turned(rotation: Array, vector: Array) -> tuple[Array, Array]:
    """Return `rotation` (3, 3) times the rotation by `vector` (3,), rad, and the derivatives (3, 3, 3).
    The first index of the derivatives is the component of `vector`."""
    R, jacobian = cv2.Rodrigues(np.asarray(vector, float))
    derivative = np.asarray(jacobian, float).reshape(3, 3, 3)
    return rotation @ np.asarray(R, float), rotation @ derivative


@dataclass(frozen=True)
class ParameterLayout:
    """Names and positions of the unknowns in the parameter vector x (p,) of the bundle adjustment."""

    names: tuple[str, ...]  # Name of each parameter
    lens: tuple[tuple[tuple[int, str], ...], ...]  # Per camera: (position in x, lens parameter)
    camera: tuple[int, ...]  # Per camera: where its rotation vector and translation (6) start in x
    pose: tuple[int | None, ...]  # Per pose: where its six parameters start in x; None for a fixed pose

    def pose_step(self, p: int, x: Array) -> Array:
        """Return the six parameters in x of target pose number p: rotation vector, rad, then translation, m.
        They are zero for a fixed pose."""
        k = self.pose[p]
        return np.zeros(6) if k is None else x[k : k + 6]

    def with_pose(self, name: str, free: bool) -> "ParameterLayout":
        """Return a copy with one more target pose, called `name`; it has six parameters if it is `free`."""
        names = [f"{name} {part}" for part in ("R1", "R2", "R3", "x", "y", "z") if free]
        first = len(self.names) if free else None
        return replace(self, names=(*self.names, *names), pose=(*self.pose, first))


def layout(
    observations: Observations,
    models: Sequence[Sequence[str]],
    reference: int,
    placed: Sequence[int] = (),
) -> ParameterLayout:
    """Return the position in the parameter vector of each unknown of the bundle adjustment.
    `models` holds, for each camera, its free lens terms (keys of `TERMS`). The target poses with the indices
    `reference` and `placed` stay fixed."""
    names: list[str] = []
    lens, camera = [], []
    for c, name in enumerate(observations.cameras):
        columns = [column for term in models[c] for column in TERMS[term]]
        lens.append(tuple((len(names) + k, column) for k, column in enumerate(columns)))
        names += [f"{name} {column}" for column in columns]
        camera.append(len(names))
        names += [f"{name} {part}" for part in ("R1", "R2", "R3", "T1", "T2", "T3")]
    plan = ParameterLayout(tuple(names), tuple(lens), tuple(camera), ())
    observed = set(np.unique(observations.pose).tolist())
    for p, name in enumerate(observations.poses):
        fixed = p == reference or p in placed or p not in observed
        plan = plan.with_pose(name, free=not fixed)
    return plan


def stepped(start: Geometry, plan: ParameterLayout, x: Array) -> Geometry:
    """Return the cameras and target poses of `start` after a step x (p,); x = 0 changes nothing."""
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
        R[c] = _turned(R[c], x[k : k + 3])[0]
        T[c] += x[k + 3 : k + 6]
    for p in range(len(plan.pose)):
        step = plan.pose_step(p, x)
        pose_R[p] = _turned(pose_R[p], step[:3])[0]
        pose_t[p] += step[3:]
    return replace(start, lens=lens, R=R, T=T, pose_R=pose_R, pose_t=pose_t)


def predict(geometry: Geometry, observations: Observations) -> Array:
    """Return the pixels (n, 2) of the observed target nodes, projected with the cameras of `geometry`."""
    world = geometry.world(observations)
    pixel = np.empty((len(observations), 2))
    for c, camera in enumerate(geometry.cameras(observations.sizes)):
        rows = observations.camera == c
        pixel[rows] = np.stack(camera.project(*world[rows].T), axis=-1)
    return pixel


def linearised(
    start: Geometry, plan: ParameterLayout, x: Array, observations: Observations
) -> tuple[Array, Array, Array]:
    """Return pixels (n, 2) of the observed target nodes after a step x (p,) from `start`, and derivatives.
    The first derivatives are by the parameters x, (n, 2, p), the second by the position of the node in the
    axes of the target, (n, 2, 3), px/m."""
    o = observations
    now = stepped(start, plan, x)
    local = (o.nominal + now.offset)[o.node]
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
        _, turn = _turned(start.R[c], x[k : k + 3])
        for i in range(3):
            J[rows, :, k + i] = np.einsum("nij,nj->ni", by_point, world[rows] @ turn[i].T)
        J[rows, :, k + 3 : k + 6] = by_point
        by_world = by_point @ R
        by_node[rows] = by_world @ now.pose_R[o.pose[rows]]
        for p in np.unique(o.pose[rows]):
            here = o.pose[rows] == p
            first = plan.pose[p]
            if first is None:
                continue
            _, turn = _turned(start.pose_R[p], plan.pose_step(p, x)[:3])
            for i in range(3):
                J[rows[here], :, first + i] = np.einsum(
                    "nij,nj->ni", by_world[here], local[rows[here]] @ turn[i].T
                )
            J[rows[here], :, first + 3 : first + 6] = by_world[here]
    return pixel, J, by_node


def covariance_to_dict(
    names: tuple[str, ...], covariance: Array, cameras: tuple[str, ...]
) -> dict[str, list[str] | list[list[float]]]:
    """Return the covariance of the parameters of `cameras` as lists that a file can hold.
    ``parameters`` holds the names of the parameters, ``lower`` the rows of the lower triangle of the
    matrix."""
    columns = [k for k, name in enumerate(names) if name.rsplit(" ", 1)[0] in cameras]
    part = covariance[np.ix_(columns, columns)]
    rows = [[float(f"{v:.12g}") for v in row[: k + 1]] for k, row in enumerate(part)]
    return {"parameters": [names[k] for k in columns], "lower": rows}


MAX_ITERATIONS = 60  # of the fit; ten usually suffice
HUBER_LIMIT = 4.0  # standard deviations beyond which the loss grows linearly; few Gaussian errors are there


class Whitener:
    """Multiplies residuals by C^(-1/2), which removes the correlation that errors of node positions cause.
    C = I + target_std^2 B B^T is the covariance of the normalised residuals; `target_std`, m, is the standard
    uncertainty of node positions. B is made of `by_node` (n, 2, 3), 1/m: the derivatives of the residuals by
    the position of a target node. `node` (n,) is the index of that node."""

    def __init__(self, node: NDArray[np.int64], by_node: Array, target_std: float):
        n, count = len(node), int(node.max()) + 1
        B = by_node.reshape(2 * n, 3) * target_std
        columns = 3 * np.repeat(node, 2)[:, None] + np.arange(3)
        self._B = sparse.csr_array(
            (B.ravel(), columns.ravel(), np.arange(0, 6 * n + 1, 3)), shape=(2 * n, 3 * count)
        )
        self._Bt = self._B.T.tocsr()
        # equivalent to a fit of all offsets with a prior, but without these parameters
        inner = np.zeros((count, 3, 3))
        np.add.at(inner, np.repeat(node, 2), B[:, :, None] * B[:, None, :])
        size, axes = np.linalg.eigh(inner)
        size = np.maximum(size, 0.0)
        # C^(-1/2) = I - B Q B^T, with a block of 3 x 3 in Q for each node
        root = np.sqrt(1.0 + size)
        self._half = _blocks((axes * (1.0 / (root * (1.0 + root)))[:, None, :]) @ axes.transpose(0, 2, 1))
        self._gain = target_std * _blocks((axes / (1.0 + size)[:, None, :]) @ axes.transpose(0, 2, 1))

    def __call__(self, rows: Array) -> Array:
        """Return residuals (2n,), or their Jacobian (2n, p), multiplied by C^(-1/2)."""
        whitened: Array = rows - self._B @ (self._half @ (self._Bt @ rows))
        return whitened

    def offsets(self, residual: Array) -> Array:
        """Return the most probable displacement of each target node, metres, from normalised residuals (2n,).
        The shape is (largest node index + 1, 3)."""
        offsets: Array = (self._gain @ (self._Bt @ residual)).reshape(-1, 3)
        return offsets


def _blocks(matrices: Array) -> sparse.csr_array:
    """Return the sparse block-diagonal matrix (3n, 3n) with the blocks `matrices` (n, 3, 3)."""
    n = len(matrices)
    columns = np.broadcast_to(3 * np.arange(n)[:, None, None] + np.arange(3), (n, 3, 3))
    return sparse.csr_array(
        (matrices.ravel(), columns.ravel(), np.arange(0, 9 * n + 1, 3)), shape=(3 * n, 3 * n)
    )


def huber(r: Array, limit: float) -> float:
    """Return the sum of Huber's loss over residuals r: r^2 for |r| up to `limit`, linear in |r| above it."""
    size = np.abs(r)
    return float(np.sum(np.where(size <= limit, size * size, limit * (2.0 * size - limit))))


def minimise(
    residual: Callable[[Array], Array],
    with_jacobian: Callable[[Array], tuple[Array, Array]],
    x: Array,
    limit: float | None,
    tolerance: float,
) -> tuple[Array, float]:
    """Minimise Huber's loss of the residuals from the start x (p,) by the Levenberg-Marquardt method.
    `with_jacobian` returns residuals and their derivatives. The search ends when a step would lower the loss
    by less than the fraction `tolerance`. Returns the best x, and the limit of Huber's loss: `limit`, or four
    robust standard deviations of the residuals if that is None."""
    damping = 1e-4
    diagonal = np.zeros_like(x)
    scale = 0.0
    for _ in range(MAX_ITERATIONS):
        r, J = with_jacobian(x)
        scale = limit or max(HUBER_LIMIT * robust_std(r), 1e-9)
        cost = huber(r, scale)
        weight = np.minimum(1.0, scale / np.maximum(np.abs(r), 1e-300))
        gradient = J.T @ (weight * r)
        # p x p normal equations: `scipy.optimize.least_squares` decomposes J at each step, which is thirty
        # times slower. They square the condition number, which costs steps but no accuracy at the minimum.
        normal = J.T @ (weight[:, None] * J)
        diagonal = np.maximum(diagonal, np.sqrt(np.diag(normal)))
        d = np.where(diagonal > 0.0, diagonal, 1.0)
        scaled, slope = normal / np.outer(d, d), gradient / d
        while True:
            step = -np.linalg.solve(scaled + damping * np.eye(len(x)), slope)
            decrease = -(2.0 * slope @ step + step @ scaled @ step)
            if decrease <= tolerance * cost or cost < 1e-24 * len(r):
                return x + step / d if decrease > 0.0 else x, scale
            trial = residual(x + step / d)
            gain = (cost - huber(trial, scale)) / decrease
            if gain > 0.0 and np.isfinite(gain):
                x = x + step / d
                damping = max(damping * max(1.0 / 30.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-12)
                break
            damping *= 10.0
            if damping > 1e8:
                return x, scale
    return x, scale


@dataclass(frozen=True)
class Fit:
    """Result of `fit`: cameras, target poses and node displacements, with covariance and residuals."""

    geometry: Geometry  # Cameras, poses and node offsets
    layout: ParameterLayout  # Meaning of the p parameters
    covariance: Array  # (p, p): Covariance of the parameters, scaled by the residuals
    residual: Array  # (n, 2): Observed minus predicted pixels
    scale: float  # Robust standard deviation of the whitened residuals
    chi2: float  # Huber's loss of the whitened residuals


def fit(
    observations: Observations,
    start: Geometry,
    models: Sequence[Sequence[str]],
    reference: int,
    target_std: float = 0.0,
    noise_scale: float | None = None,
    placed: Sequence[int] = (),
) -> Fit:
    """Fit all cameras and target poses to all observations (bundle adjustment with Huber's loss).
    `models` holds the free lens terms of each camera; the poses with the indices `reference` and `placed`
    stay fixed. `target_std`, m, is the standard uncertainty of node positions. `noise_scale`, actual over
    stated pixel noise, sets Huber's limit; None: it is estimated."""
    o = observations
    plan = layout(o, models, reference, placed)
    start = replace(start, offset=np.zeros_like(start.offset))
    inverse = 1.0 / np.repeat(o.std, 2)
    whitener: Whitener | None = None

    def residual(x: Array) -> Array:
        r = (predict(stepped(start, plan, x), o) - o.pixel).ravel() * inverse
        return whitener(r) if whitener else r

    def with_jacobian(x: Array) -> tuple[Array, Array]:
        pixel, J, _ = linearised(start, plan, x, o)
        r, J = (pixel - o.pixel).ravel() * inverse, J.reshape(2 * len(o), -1)
        J *= inverse[:, None]
        return (whitener(r), whitener(J)) if whitener else (r, J)

    x = np.zeros(len(plan.names))
    stated_limit = HUBER_LIMIT * noise_scale if noise_scale else None
    # a coarse fit comes first, because Huber's limit depends on residuals and the whitening on the geometry
    for tolerance in (1e-2, 1e-7):
        if target_std > 0.0:
            whitener = Whitener(o.node, linearised(start, plan, x, o)[2] / o.std[:, None, None], target_std)
        x, limit = minimise(residual, with_jacobian, x, stated_limit, tolerance)
    r, J = with_jacobian(x)
    # exact simulated points leave no residuals; keep the covariance above zero
    scale = max(robust_std(r) * np.sqrt(len(r) / max(len(r) - len(x), 1)), 1e-6)
    weight = np.minimum(1.0, limit / np.maximum(np.abs(r), 1e-300))
    normal = J.T @ (weight[:, None] * J)
    d = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    units = np.outer(d, d)
    covariance = scale**2 * np.linalg.pinv(normal * units, rcond=1e-15, hermitian=True) * units
    geometry = stepped(start, plan, x)
    predicted = predict(geometry, o)
    if whitener:
        offset = np.zeros_like(start.offset)
        estimate = whitener.offsets((o.pixel - predicted).ravel() * inverse)
        offset[: len(estimate)] = estimate
        geometry = replace(geometry, offset=offset)
        predicted = predict(geometry, o)
    return Fit(geometry, plan, covariance, o.pixel - predicted, float(scale), huber(r, limit))
