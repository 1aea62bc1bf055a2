"""The parameters of the joint fit: which of them moves what, and the derivatives of the pixels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from wavefield.calibration.observations import Geometry, Observations
from wavefield.rig.lens import LENS, Array, project

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
    "k4": ("k4",),
    "tilt": ("tau_x", "tau_y"),
}


def terms_of_kind(terms: Sequence[str], fisheye: bool) -> tuple[str, ...]:
    """The terms that a kind of lens has: a fisheye's polynomial has k4, and its centre absorbs a tilt."""
    if not fisheye:
        return tuple(term for term in terms if term != "k4")
    own = ["c" if term == "tilt" else term for term in terms if term != "p"]
    return tuple(dict.fromkeys([*own, *(["k4"] if "k3" in own else [])]))


def _turned(rotation: Array, vector: Array) -> tuple[Array, Array]:
    """Rotation . exp(vector), and its derivatives (3, 3, 3) with respect to the vector."""
    R, jacobian = cv2.Rodrigues(np.asarray(vector, float))
    derivative = np.asarray(jacobian, float).reshape(3, 3, 3)
    return rotation @ np.asarray(R, float), rotation @ derivative


@dataclass(frozen=True)
class ParameterLayout:
    """Which parameter moves what."""

    names: tuple[str, ...]  # One per parameter
    lens: tuple[tuple[tuple[int, str], ...], ...]  # Per camera, (parameter, moved term)
    camera: tuple[int, ...]  # Per camera, the first of its six (rotation vector, translation)
    # Per pose of the target, (parameter, which of the six); none for the pose that defines the frame
    pose: tuple[tuple[tuple[int, int], ...], ...]

    def pose_step(self, p: int, x: Array) -> Array:
        """Rotation vector and translation by which parameters x move a pose, (6,)."""
        step = np.zeros(6)
        for k, which in self.pose[p]:
            step[which] = x[k]
        return step

    def with_pose(self, name: str, free: Sequence[int]) -> "ParameterLayout":
        """The layout for one more pose, some of whose six parameters are free."""
        moves = tuple((len(self.names) + k, which) for k, which in enumerate(free))
        names = (f"{name} {('R1', 'R2', 'R3', 'x', 'y', 'z')[which]}" for which in free)
        return replace(self, names=(*self.names, *names), pose=(*self.pose, moves))


def layout(
    observations: Observations,
    models: Sequence[Sequence[str]],
    reference: int,
    flat: Sequence[int] = (),
    placed: Sequence[int] = (),
) -> ParameterLayout:
    """Lay out the parameters of the joint fit."""
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
        plan = plan.with_pose(name, () if fixed else (2, 3, 4) if p in flat else range(6))
    return plan


def moved(start: Geometry, plan: ParameterLayout, x: Array) -> Geometry:
    """The geometry at given parameters x (p,), relative to a start."""
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
    """Pixels predicted by a geometry, (n, 2)."""
    world = geometry.world(observations)
    pixel = np.empty((len(observations), 2))
    for c, camera in enumerate(geometry.cameras(observations.sizes)):
        rows = observations.camera == c
        pixel[rows] = np.stack(camera.project(*world[rows].T), axis=-1)
    return pixel


def linearised(
    start: Geometry, plan: ParameterLayout, x: Array, observations: Observations
) -> tuple[Array, Array, Array]:
    """Pixels (n, 2) predicted at given parameters (p,), and their derivatives.
    These are (n, 2, p) by the parameters, and (n, 2, 3) by the nodes' offsets, px per metre.
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
        _, turn = _turned(start.R[c], x[k : k + 3])
        for i in range(3):
            J[rows, :, k + i] = np.einsum("nij,nj->ni", by_point, world[rows] @ turn[i].T)
        J[rows, :, k + 3 : k + 6] = by_point
        by_world = by_point @ R
        by_node[rows] = by_world @ now.pose_R[o.pose[rows]]
        for p in np.unique(o.pose[rows]):
            here = o.pose[rows] == p
            _, turn = _turned(start.pose_R[p], plan.pose_step(p, x)[:3])
            for k, which in plan.pose[p]:
                if which < 3:
                    J[rows[here], :, k] = np.einsum(
                        "nij,nj->ni", by_world[here], local[rows[here]] @ turn[which].T
                    )
                else:
                    J[rows[here], :, k] = by_world[here][:, :, which - 3]
    return pixel, J, by_node


def covariance_to_dict(
    names: tuple[str, ...], covariance: Array, cameras: tuple[str, ...]
) -> dict[str, list[str] | list[list[float]]]:
    """The cameras' part of a fit's covariance (p, p), as the rig's file stores it."""
    columns = [k for k, name in enumerate(names) if name.rsplit(" ", 1)[0] in cameras]
    part = covariance[np.ix_(columns, columns)]
    rows = [[float(f"{v:.12g}") for v in row[: k + 1]] for k, row in enumerate(part)]
    return {"parameters": [names[k] for k in columns], "lower": rows}
