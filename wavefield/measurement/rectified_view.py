"""The rectified images of the cameras that measure z: their plane, and what each camera shows of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavefield.errors import RigError
from wavefield.matching import MatchSettings
from wavefield.matching.matching_kernels import BLOCK
from wavefield.matching.prepared import Mask
from wavefield.measurement.rectify import sight_map
from wavefield.measurement.regrid import BlockLattice
from wavefield.measurement.sight import Sight
from wavefield.rig import Camera
from wavefield.rig.field import view_on_water

Float = NDArray[np.floating]

_MIN_BLOCKS = 8  # along each side of the common view
_MARGIN_BLOCKS = 4  # around the nodes: the windows of the outermost blocks need their surroundings
_LENS_BLUR_PX = 0.6  # of a usual lens


@dataclass(frozen=True)
class RectifiedPlane:
    """Pixels of the rectified images on z = 0, in apparent coordinates of the reference."""

    origin: tuple[float, float]  # x, y of the first pixel, metres
    pixel: float  # metres
    shape: tuple[int, int]  # blocks (ny, nx)

    @property
    def lattice(self) -> BlockLattice:
        """Centres of the blocks, metres."""
        x, y = (first + 0.5 * (BLOCK - 1) * self.pixel for first in self.origin)
        return BlockLattice(x, y, BLOCK * self.pixel, self.shape)

    @property
    def x(self) -> Float:
        """Pixels along x, metres."""
        return np.asarray(self.origin[0] + self.pixel * np.arange(self.shape[1] * BLOCK))

    @property
    def y(self) -> Float:
        """Pixels along y, metres."""
        return np.asarray(self.origin[1] + self.pixel * np.arange(self.shape[0] * BLOCK))


@dataclass(frozen=True)
class RectifiedView:
    """What one camera shows of the rectified plane z = 0."""

    maps: tuple[Float, Float]  # (row, column): places in the camera's image (`sight_map`)
    visible: NDArray[np.bool_]  # (row, column): where the camera sees the plane
    visible_blocks: NDArray[np.float32]  # (ny, nx): visible fraction of every block
    mask: Mask  # the same, ready for matching
    blur: tuple[float, float]  # of the rectified image along x and y that makes beads alike, px


def fit_plane(
    cameras: Sequence[Camera], x: Float, y: Float, z_range: tuple[float, float], pixel: float
) -> RectifiedPlane:
    """The part of the plane where nodes x, y (ny, nx) appear at any height to the reference and a partner.
    The reference comes first. One partner is enough: a node moves to opposite sides in opposite cameras.
    """
    lo, hi = np.full(2, np.inf), np.full(2, -np.inf)
    edge_x = np.concatenate([x[0], x[-1], x[:, 0], x[:, -1]])
    edge_y = np.concatenate([y[0], y[-1], y[:, 0], y[:, -1]])
    for z in z_range:
        reference, *others = (np.stack(one.unproject(*one.project(edge_x, edge_y, z))) for one in cameras)
        # NaN where a camera does not see the node
        least, most = np.fmax.reduce(others), np.fmin.reduce(others)
        lo = np.fmin(lo, np.fmin.reduce(np.fmin(reference, least), axis=1))
        hi = np.fmax(hi, np.fmax.reduce(np.fmax(reference, most), axis=1))
    views = [_reach(one, np.stack([edge_x, edge_y], axis=-1)) for one in cameras]
    # beyond what the second widest of the views reaches, no two cameras see anything
    lo = np.maximum(lo, np.sort([view.min(axis=0) for view in views], axis=0)[1])
    hi = np.minimum(hi, np.sort([view.max(axis=0) for view in views], axis=0)[-2])
    blocks = np.ceil((hi - lo) / (BLOCK * pixel)) + 2 * _MARGIN_BLOCKS
    if not (blocks >= _MIN_BLOCKS + 2 * _MARGIN_BLOCKS).all():
        raise RigError("no two cameras see the grid: does the grid lie in the cameras' view?")
    nx, ny = (int(scipy.fft.next_fast_len(int(n))) for n in blocks)
    x0, y0 = 0.5 * (lo + hi) - 0.5 * pixel * (np.array([nx, ny]) * BLOCK - 1)
    return RectifiedPlane((float(x0), float(y0)), pixel, (ny, nx))


def _reach(camera: Camera, edge: Float) -> Float:
    """Places that bound what a camera sees of the plane, (n, 2), metres.
    Where the horizon is in view, visible nodes of the edge (m, 2) are added: `view_on_water` bounds less.
    """
    view = view_on_water(camera)
    if np.isfinite(camera.corners()).all():
        return view
    return np.concatenate([view, edge[camera.sees(edge[:, 0], edge[:, 1], 0.0)]])


def rectified_views(
    sights: Mapping[str, Sight], plane: RectifiedPlane, middle: tuple[float, float], stereo: MatchSettings
) -> dict[str, RectifiedView]:
    """Maps, masks and blur of every camera; with the middle of the grid, metres."""
    blur = _blur(sights, plane.pixel, middle)
    out = {}
    for name, sight in sights.items():
        X, Y, visible = sight_map(sight.camera, plane.x, plane.y)
        blocks = cv2.resize(visible.astype(np.float32), plane.shape[::-1], interpolation=cv2.INTER_AREA)
        out[name] = RectifiedView(
            (X, Y), visible, np.asarray(blocks, np.float32), Mask.of(visible, stereo), blur[name]
        )
    return out


def _blur(
    sights: Mapping[str, Sight], pixel: float, middle: tuple[float, float]
) -> dict[str, tuple[float, float]]:
    """Standard deviations along x and y, px, that make a bead as wide in every rectified image.
    Beads of an oblique camera are wider across its view, which would pull at the surface.
    """
    variances = {}
    for name, sight in sights.items():
        side = np.linalg.inv(sight.camera.jacobian(*middle, 0.0)[:, :2]) / pixel
        # variances in px: the lens, the pixel, the spline by which the image is read
        sensor = (_LENS_BLUR_PX / sight.binning) ** 2 + 1.0 / 12.0 + 6.0 / 12.0
        sensor += 0.25 * (sight.binning > 1)  # half a side: what goes before `bin_pixels`
        variances[name] = sensor * np.sum(side**2, axis=1)
    widest = np.max(list(variances.values()), axis=0)
    blur = {name: np.sqrt(widest - own) for name, own in variances.items()}
    return {name: (float(s[0]), float(s[1])) for name, s in blur.items()}
