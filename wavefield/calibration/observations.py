"""All nodes seen in all views, as flat arrays, and the geometry that is fitted to them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.points import TargetPoints
from wavefield.rig.camera import Camera
from wavefield.rig.lens import LENS, Array

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Observations:
    """Nodes of the target seen by the cameras."""

    cameras: tuple[str, ...]  # Names; the integer arrays below count into these
    poses: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]  # (width, height): Image size of each camera, px
    nodes: Index  # (N, 2): Indices (i, j) of the target's nodes that were seen
    mesh: float  # Distance of neighbouring nodes, metres
    camera: Index  # (n,): Who saw which node in which pose of the target
    pose: Index
    node: Index
    pixel: Array  # (n, 2): Where, px
    std: Array  # (n,): Standard uncertainty per axis, px
    origin: tuple[float, float] = (0.0, 0.0)  # (float, float): Where node (0, 0) lies, metres
    height: Array | None = None  # (N,): Of the nodes above the target's plane, metres; zero if left out
    placed: tuple[int, ...] = ()  # Poses whose nodes are in the physical frame already

    def __len__(self) -> int:
        return len(self.camera)

    @property
    def plan(self) -> Array:
        """Positions of the nodes on a perfect target, (N, 3), metres."""
        height = np.zeros(len(self.nodes)) if self.height is None else self.height
        return np.column_stack([self.origin + self.nodes * self.mesh, height])

    def only(self, keep: NDArray[np.bool_]) -> "Observations":
        """Some of the observations; names and nodes stay.

        With keep (n,).
        """
        parts = {key: getattr(self, key)[keep] for key in ("camera", "pose", "node", "pixel", "std")}
        return replace(self, **parts)

    def of_camera(self, camera: int) -> "Observations":
        """What one camera saw, with the poses it saw."""
        part = self.only(self.camera == camera)
        seen = np.unique(part.pose)
        return replace(
            part,
            cameras=(self.cameras[camera],),
            sizes=(self.sizes[camera],),
            poses=tuple(self.poses[p] for p in seen),
            placed=tuple(int(np.searchsorted(seen, p)) for p in self.placed if p in seen),
            camera=np.zeros(len(part), np.int64),
            pose=np.searchsorted(seen, part.pose),
        )


def collect(
    views: Mapping[str, Mapping[str, TargetPoints]], mesh: float, origin: tuple[float, float] = (0.0, 0.0)
) -> Observations:
    """Flatten the views of all cameras.

    With mesh, metres; origin (float, float), metres.
    """
    cameras = tuple(views)
    poses: list[str] = []
    for of_camera in views.values():
        poses += [pose for pose in of_camera if pose not in poses]
    rows = [
        (c, poses.index(pose), points)
        for c, name in enumerate(cameras)
        for pose, points in views[name].items()
        if len(points)
    ]

    def stack(parts: Sequence[NDArray[Any]], width: int) -> NDArray[Any]:
        return np.concatenate(parts) if parts else np.zeros((0, width) if width > 1 else 0)

    heights = [np.zeros(len(p)) if p.z is None else np.asarray(p.z, float) for _, _, p in rows]
    nanometres = np.rint(1e9 * stack(heights, 1)).astype(np.int64)
    all_nodes = np.column_stack([stack([p.node for _, _, p in rows], 2).astype(np.int64), nanometres])
    unique, node = np.unique(all_nodes, axis=0, return_inverse=True)
    counts = [len(p) for _, _, p in rows]
    return Observations(
        cameras,
        tuple(poses),
        tuple(next(((p.size[0], p.size[1]) for p in views[name].values()), (0, 0)) for name in cameras),
        unique[:, :2],
        float(mesh),
        np.repeat([c for c, _, _ in rows], counts).astype(np.int64),
        np.repeat([q for _, q, _ in rows], counts).astype(np.int64),
        np.ravel(node).astype(np.int64),
        stack([np.asarray(p.pixel, float) for _, _, p in rows], 2),
        stack([np.asarray(p.std, float) for _, _, p in rows], 1),
        origin,
        np.asarray(1e-9 * unique[:, 2], float) if unique[:, 2].any() else None,
        tuple(sorted({q for _, q, points in rows if points.placed})),
    )


@dataclass(frozen=True)
class Geometry:
    """Cameras and poses of the target."""

    lens: Array  # (C, 12): `LENS` of each camera
    R: Array  # (C, 3, 3): World to camera, metres
    T: Array
    pose_R: Array  # (P, 3, 3): Target to world, metres
    pose_t: Array
    # (N, 3): How far each node is from its place on a perfect target, metres, in the target's axes
    offset: Array

    def camera(self, c: int, size: tuple[int, int]) -> Camera:
        """One camera as the rig wants it.

        With size (width, height), px.
        """
        terms = dict(zip(LENS, self.lens[c].tolist(), strict=True))
        return Camera(rotation=self.R[c], translation=self.T[c], size=size, **terms)

    def world(self, observations: Observations) -> Array:
        """Where the nodes were, (n, 3), metres.

        Returns (n, 3).
        """
        points = (observations.plan + self.offset)[observations.node]
        pose = observations.pose
        world: Array = np.einsum("nij,nj->ni", self.pose_R[pose], points) + self.pose_t[pose]
        return world
