"""The parameters of the joint fit: which moves what, and what the images become when they move."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

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
    "tilt": ("tau_x", "tau_y"),
}


def _turn(rotation: Array, vector: Array) -> tuple[Array, Array]:
    """Rotation . exp(vector), and its derivatives (3, 3, 3) with respect to the vector."""
    R, jacobian = cv2.Rodrigues(np.asarray(vector, float))
    derivative = np.asarray(jacobian, float).reshape(3, 3, 3)
    return rotation @ np.asarray(R, float), rotation @ derivative


@dataclass(frozen=True)
class ParameterLayout:
    """Which parameter moves what."""

    names: tuple[str, ...]  # One per parameter, for people
    lens: tuple[tuple[tuple[int, str], ...], ...]  # (int, str): Per camera, (parameter, moved term)
    # Per camera, the first of its six parameters of pose (rotation vector, translation)
    camera: tuple[int, ...]
    # (int, int): Per pose of the target, (parameter, which of the six); none for the pose that defines the
    # frame
    pose: tuple[tuple[tuple[int, int], ...], ...]


def layout(
    observations: Observations,
    models: Sequence[Sequence[str]],
    reference: int,
    flat: Sequence[int] = (),
    placed: Sequence[int] = (),
) -> ParameterLayout:
    """Lay out the parameters of the joint fit."""
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
        held = p == reference or p in placed or p not in seen
        free = [] if held else [2, 3, 4] if p in flat else list(range(6))
        pose.append(tuple((len(names) + k, which) for k, which in enumerate(free)))
        names += [f"{name} {('R1', 'R2', 'R3', 'x', 'y', 'z')[which]}" for which in free]
    return ParameterLayout(tuple(names), tuple(lens), tuple(camera), tuple(pose))


def moved(start: Geometry, plan: ParameterLayout, x: Array) -> Geometry:
    """The geometry at given parameters, counted from a start.

    With x (p,).
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

    Returns (n, 2): Pixels.
    """
    o = observations
    world = geometry.world(o)
    pixel = np.empty((len(o), 2))
    for c, size in enumerate(o.sizes):
        rows = o.camera == c
        pixel[rows] = np.stack(geometry.camera(c, size).project(*world[rows].T), axis=-1)
    return pixel


def linearised(
    start: Geometry, plan: ParameterLayout, x: Array, observations: Observations
) -> tuple[Array, Array, Array]:
    """Pixels predicted at given parameters, with derivatives.

    Returns pixel (n, 2): Pixels; jacobian (n, 2, p): Derivatives with respect to the parameters; by_node (n,
    2, 3): Derivatives with respect to the nodes' offsets, px per metre.
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


def covariance_to_dict(names: tuple[str, ...], covariance: Array, cameras: tuple[str, ...]) -> dict[str, Any]:
    """The cameras' part of a fit's covariance, as the rig's file keeps it.

    With covariance (p, p).
    """
    pick = [k for k, name in enumerate(names) if name.rsplit(" ", 1)[0] in cameras]
    part = covariance[np.ix_(pick, pick)]
    rows = [[float(f"{v:.12g}") for v in row[: k + 1]] for k, row in enumerate(part)]
    return {"parameters": [names[k] for k in pick], "lower": rows}
