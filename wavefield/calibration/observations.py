"""Observations of the target in all images, the geometry of cameras and poses, and limits for a usable rig.

A pose is one position of the target, photographed by several cameras; a view is the image of one pose by one
camera. A node is a marked point of the target. The flat view is the one of the target on the plane z = 0.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from wavefield.calibration.points import Mask, Nodes, TargetPoints
from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.field import view_on_water
from wavefield.rig.lens import LENS, Array


@dataclass(frozen=True)
class CalibrationLimits:
    """Limits of a usable calibration: nodes per view, tilts, predicted errors, distances and coverage."""

    min_nodes: int = 12  # in a view: 24 coordinates, three times the parameters of a homography
    min_tilt_range: float = 10.0  # degrees between a camera's views; below it the focal length is uncertain
    max_reprojection_std: float = 0.3  # px: predicted for projected points where the rig will be used
    max_z_std: float = 1e-3  # m: predicted for z where the rig will be used
    max_distance_error: float = 0.05  # relative, of a camera's distance from the origin measured by hand
    min_coverage: float = 0.4  # fraction of an image that the target covers; below it a note is made


LIMITS = CalibrationLimits()
OUTLIER_DEVIATIONS = 6.0  # robust standard deviations from a fit: Gaussian errors of 10,000 nodes stay within
MIN_OUTLIER_PX = 0.1  # px; a smaller residual is never an outlier
MIN_MATCHES = 50  # between two cameras, for their relative pose and the water level
MAX_MATCHES = 3000  # matches used in a fit; more do not change the result


@dataclass
class Findings:
    """Collects the problems and notes of a calibration, as sentences for the user."""

    problems: list[str] = field(default_factory=list)  # Why the rig cannot be used, and what to do
    notes: list[str] = field(default_factory=list)  # Remarks, for example on views that were left out
    left_out: dict[str, int] = field(default_factory=dict)  # Points left out, by view ("camera pose")

    def leave_out(self, camera: str, pose: str, points: int, reason: str = "") -> None:
        """Record that `points` points of a view were left out; if a `reason` is given, add it as a note."""
        view = f"{camera} {pose}"
        self.left_out[view] = self.left_out.get(view, 0) + points
        if reason:
            self.notes.append(f"{view}: {reason}; left out")


@dataclass(frozen=True)
class Observations:
    """All n observations of a target. Each is the pixel of one of N nodes, in one pose, in one camera."""

    cameras: tuple[str, ...]  # Names; `camera` below holds indices into them, as `pose` into `poses`
    poses: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]  # Image (width, height) of each camera, px
    nodes: Nodes  # (N, 2): Indices (i, j) of the nodes that were observed
    nominal: Array  # (N, 3): Their nominal positions in the target's axes, metres
    mesh: float  # Distance of neighbouring nodes, metres
    camera: Nodes  # (n,): Camera of each observation
    pose: Nodes  # (n,): Pose of the target
    node: Nodes  # (n,): Row of `nodes`
    pixel: Array  # (n, 2): Position in the image, px
    std: Array  # (n,): Standard uncertainty per axis, px
    placed: tuple[int, ...] = ()  # Poses whose nodes have known positions in the rig's frame

    def __len__(self) -> int:
        return len(self.camera)

    def only(self, keep: Mask) -> "Observations":
        """Return a copy with only the observations where the mask `keep` (n,) is true. All nodes are kept."""
        parts = {key: getattr(self, key)[keep] for key in ("camera", "pose", "node", "pixel", "std")}
        return replace(self, **parts)

    @staticmethod
    def of_points(
        cameras: tuple[str, ...], sizes: tuple[tuple[int, int], ...], poses: tuple[str, ...], count: int
    ) -> "Observations":
        """Return placeholder observations of `count` points by all cameras in the last pose, for `predict`.
        Nominal positions of the points are zero: put their positions into `Geometry.offset`."""
        n = len(cameras) * count
        return Observations(
            cameras,
            poses,
            sizes,
            nodes=np.zeros((count, 2), np.int64),
            nominal=np.zeros((count, 3)),
            mesh=1.0,
            camera=np.repeat(np.arange(len(cameras)), count),
            pose=np.full(n, len(poses) - 1),
            node=np.tile(np.arange(count), len(cameras)),
            pixel=np.zeros((n, 2)),
            std=np.ones(n),
        )


def collect(
    views: Mapping[str, Mapping[str, TargetPoints]], mesh: float, origin: tuple[float, float] = (0.0, 0.0)
) -> Observations:
    """Return the observations of all `views`, which hold target points by camera and by pose of the target.
    `mesh` is the distance between neighbouring nodes, `origin` the position (x, y) of node (0, 0), in metres.
    """
    cameras = tuple(views)
    poses = tuple(dict.fromkeys(pose for by_pose in views.values() for pose in by_pose))
    rows = [
        (c, poses.index(pose), points)
        for c, name in enumerate(cameras)
        for pose, points in views[name].items()
        if len(points)
    ]
    none = np.zeros((0, 2))
    heights = [np.zeros(len(p)) if p.z is None else np.asarray(p.z, float) for _, _, p in rows]
    nanometres = np.rint(1e9 * np.concatenate([none[:, 0], *heights])).astype(np.int64)
    all_nodes = np.concatenate([none.astype(np.int64), *(p.node for _, _, p in rows)])
    unique, node = np.unique(np.column_stack([all_nodes, nanometres]), axis=0, return_inverse=True)
    counts = [len(p) for _, _, p in rows]
    return Observations(
        cameras,
        poses,
        tuple(next(((p.size[0], p.size[1]) for p in views[name].values()), (0, 0)) for name in cameras),
        nodes=unique[:, :2],
        nominal=np.column_stack([origin + unique[:, :2] * float(mesh), 1e-9 * unique[:, 2]]),
        mesh=float(mesh),
        camera=np.repeat([c for c, _, _ in rows], counts).astype(np.int64),
        pose=np.repeat([q for _, q, _ in rows], counts).astype(np.int64),
        node=np.ravel(node).astype(np.int64),
        pixel=np.concatenate([none, *(np.asarray(p.pixel, float) for _, _, p in rows)]),
        std=np.concatenate([none[:, 0], *(np.asarray(p.std, float) for _, _, p in rows)]),
        placed=tuple(sorted({q for _, q, points in rows if points.placed})),
    )


@dataclass(frozen=True)
class Geometry:
    """Lenses and positions of C cameras, P poses of a target, and position errors of the target's N nodes."""

    lens: Array  # (C, 12): Lens of each camera, in the order of `LENS`
    R: Array  # (C, 3, 3): Rotation from world to camera
    T: Array  # (C, 3): Translation from world to camera, metres
    pose_R: Array  # (P, 3, 3): Rotation from target to world
    pose_t: Array  # (P, 3): Translation from target to world, metres
    offset: Array  # (N, 3): Deviation of each node from its nominal position, metres, in the target's axes

    def cameras(self, sizes: Sequence[tuple[int, int]]) -> list[Camera]:
        """Return the cameras as `Camera` objects; `sizes` holds the (width, height) of their images, px."""
        return [
            Camera(rotation=R, translation=T, size=size, **dict(zip(LENS, lens.tolist(), strict=True)))
            for lens, R, T, size in zip(self.lens, self.R, self.T, sizes, strict=True)
        ]

    def with_pose(self, R: Array, t: Array) -> "Geometry":
        """Return a copy with one more pose (R, t) of the target in the world."""
        return replace(
            self, pose_R=np.concatenate([self.pose_R, R[None]]), pose_t=np.concatenate([self.pose_t, t[None]])
        )

    def world(self, observations: Observations) -> Array:
        """Return the position (n, 3) in the world frame, metres, of the node of each observation."""
        points = (observations.nominal + self.offset)[observations.node]
        pose = observations.pose
        world: Array = np.einsum("nij,nj->ni", self.pose_R[pose], points) + self.pose_t[pose]
        return world


def common_extent(cameras: Sequence[Camera], nominal: Array) -> tuple[Array, Array]:
    """Return two corners (x, y), m, lowest and highest, of the rectangle on z = 0 that all cameras see.
    If cameras see no common area, the rectangle encloses the target nodes `nominal` (N, 3), m."""
    try:
        views = [view_on_water(camera) for camera in cameras]
    except RigError:  # without a flat view, the plane z = 0 may be out of view
        views = []
    if views:
        lo = np.max([view.min(axis=0) for view in views], axis=0)
        hi = np.min([view.max(axis=0) for view in views], axis=0)
        if (hi > lo).all():
            return lo, hi
    return nominal[:, :2].min(axis=0), nominal[:, :2].max(axis=0)
