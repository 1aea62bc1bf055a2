"""What the target images showed: nodes, cameras and poses, with the limits that a usable rig must meet."""

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
    """What a usable calibration needs."""

    min_nodes: int = 12  # of the target in a view
    min_tilt_range: float = 10.0  # degrees between views of a camera: with less its focal length is uncertain
    max_reprojection_std: float = 0.3  # px: of a pixel of each camera, where the rig will be used
    max_z_std: float = 1e-3  # m: of z there
    max_distance_error: float = 0.05  # of a camera's distance from the origin, if it was measured by hand
    min_coverage: float = 0.4  # of an image held by views of the target: with less a note is made


LIMITS = CalibrationLimits()
OUTLIER_DEVIATIONS = 6.0  # of a point from a fit to the others, over the typical deviation
MIN_OUTLIER_PX = 0.1  # what misses a fit by less is no outlier
MIN_MATCHES = 50  # between two cameras, to find how they stand and where the water is
MAX_MATCHES = 3000  # more do not change the result


@dataclass
class Findings:
    """Problems and notes for the user, as sentences."""

    problems: list[str] = field(default_factory=list)  # Why the rig cannot be used, and what to do
    notes: list[str] = field(default_factory=list)  # What was left out, and other remarks
    left_out: dict[str, int] = field(default_factory=dict)  # Points left out per view ("camera pose")

    def leave_out(self, camera: str, pose: str, points: int, reason: str = "") -> None:
        """Count points that are left out, and note the reason."""
        view = f"{camera} {pose}"
        self.left_out[view] = self.left_out.get(view, 0) + points
        if reason:
            self.notes.append(f"{view}: {reason}; left out")


Index = Nodes


@dataclass(frozen=True)
class Observations:
    """Nodes of the target observed by the cameras."""

    cameras: tuple[str, ...]  # Names; the integer arrays below are indices of these
    poses: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]  # Image (width, height) of each camera, px
    nodes: Index  # (N, 2): Indices (i, j) of the target's nodes that were observed
    plan: Array  # (N, 3): Their positions on a perfect target, metres
    mesh: float  # Distance of neighbouring nodes, metres
    camera: Index  # (n,): Which camera observed which node in which pose of the target
    pose: Index
    node: Index
    pixel: Array  # (n, 2): Position in the image, px
    std: Array  # (n,): Standard uncertainty per axis, px
    placed: tuple[int, ...] = ()  # Poses whose nodes are in the physical frame already

    def __len__(self) -> int:
        return len(self.camera)

    def only(self, keep: Mask) -> "Observations":
        """A subset of the observations; names and nodes are kept."""
        parts = {key: getattr(self, key)[keep] for key in ("camera", "pose", "node", "pixel", "std")}
        return replace(self, **parts)

    @staticmethod
    def of_points(
        cameras: tuple[str, ...], sizes: tuple[tuple[int, int], ...], poses: tuple[str, ...], count: int
    ) -> "Observations":
        """Free points, all observed by every camera in the last pose; pixels are set to zero."""
        n = len(cameras) * count
        return Observations(
            cameras,
            poses,
            sizes,
            nodes=np.zeros((count, 2), np.int64),
            plan=np.zeros((count, 3)),
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
    """Observations from the views of all cameras; mesh, and origin of node (0, 0), in metres."""
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
        plan=np.column_stack([origin + unique[:, :2] * float(mesh), 1e-9 * unique[:, 2]]),
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
    """Cameras and poses of the target."""

    lens: Array  # (C, 12): `LENS` of each camera
    R: Array  # (C, 3, 3): World to camera, metres
    T: Array
    pose_R: Array  # (P, 3, 3): Target to world, metres
    pose_t: Array
    offset: Array  # (N, 3): Of each node from its position on a perfect target, metres, in the target's axes

    def cameras(self, sizes: Sequence[tuple[int, int]]) -> list[Camera]:
        """The cameras, with images of given sizes (width, height), px."""
        return [
            Camera(rotation=R, translation=T, size=size, **dict(zip(LENS, lens.tolist(), strict=True)))
            for lens, R, T, size in zip(self.lens, self.R, self.T, sizes, strict=True)
        ]

    def with_pose(self, R: Array, t: Array) -> "Geometry":
        """Add a pose of the target."""
        return replace(
            self, pose_R=np.concatenate([self.pose_R, R[None]]), pose_t=np.concatenate([self.pose_t, t[None]])
        )

    def world(self, observations: Observations) -> Array:
        """Positions of the observed nodes in the world, (n, 3), metres."""
        points = (observations.plan + self.offset)[observations.node]
        pose = observations.pose
        world: Array = np.einsum("nij,nj->ni", self.pose_R[pose], points) + self.pose_t[pose]
        return world


def common_extent(cameras: Sequence[Camera], plan: Array) -> tuple[Array, Array]:
    """Lower and upper (x, y) of the field that all cameras see on z = 0, or else of the target's plan, m."""
    try:
        views = [view_on_water(camera) for camera in cameras]
    except RigError:  # of a rig in a frame of its own, z = 0 may be out of view
        views = []
    if views:
        lo = np.max([view.min(axis=0) for view in views], axis=0)
        hi = np.min([view.max(axis=0) for view in views], axis=0)
        if (hi > lo).all():
            return lo, hi
    return plan[:, :2].min(axis=0), plan[:, :2].max(axis=0)
