"""`GridGeometry`: everything that follows from rig, grid and settings alone, computed once for all frames.

For each camera, `Sight` gives the image position of the nodes at any elevation. `RectifiedView` holds the
pixel maps that rectify its images to the plane z = 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavefield.errors import ExperimentError, RigError
from wavefield.grid import Grid
from wavefield.matching import MatchSettings
from wavefield.matching.kernels import BLOCK
from wavefield.matching.prepared import Mask
from wavefield.measurement.rectify import binned, sight_map
from wavefield.measurement.regrid import BlockLattice
from wavefield.measurement.settings import Settings
from wavefield.rig import Camera, Rig
from wavefield.rig.field import pixel_at, pixel_sides, view_on_water
from wavefield.rig.rig import pairs_of

Float = NDArray[np.floating]

# Order of the polynomials in z. Image positions are ratios of linear functions of z, and |z| is small
# compared with the distance, so order 4 is exact to better than a thousandth of a pixel.
_ORDER = 4


class Sight:
    """Image positions and Jacobians of the nodes x, y (ny, nx) in one camera, as polynomials in z.
    `camera` and `lattice` are for the binned image; `binning` is the side of a binned pixel in raw pixels."""

    def __init__(
        self, camera: Camera, binning: int, x: Float, y: Float, z_range: tuple[float, float]
    ) -> None:
        self.binning, self.camera = binning, binned(camera, binning)
        w, h = self.camera.size
        first = 0.5 * (BLOCK - 1)
        self.lattice = BlockLattice(first, first, float(BLOCK), (h // BLOCK, w // BLOCK))
        self._z_middle, self._z_half = 0.5 * (z_range[0] + z_range[1]), 0.5 * (z_range[1] - z_range[0])
        knots = np.cos(np.pi * (np.arange(_ORDER + 1) + 0.5) / (_ORDER + 1))
        values = []
        for t in knots:
            z = self._z_middle + self._z_half * t
            X, Y = self.camera.project(x, y, z)
            J = self.camera.jacobian(x, y, z)
            values.append(np.concatenate([[X, Y], np.moveaxis(J.reshape(*X.shape, 6), -1, 0)]))
        # (8, 5, ny, nx): X, Y, then the Jacobian row by row
        inverse = np.linalg.inv(np.vander(knots, increasing=True))
        self._polynomial = np.einsum("pk,kfyx->fpyx", inverse, np.array(values)).astype(np.float32)

    def at(self, z: Float, every: int = 1) -> NDArray[np.float32]:
        """Return an array (8, ny, nx): positions X, Y (px of the binned image) and Jacobians by rows (px/m).
        The nodes are at z, metres. If `every` is n > 1, z and the results are for every n-th node each
        way."""
        return self._evaluate(z, self._polynomial[..., ::every, ::every])

    def position(self, z: Float) -> NDArray[np.float32]:
        """Return the positions X, Y in the binned image, px, of nodes at z (ny, nx), metres: (2, ny, nx)."""
        return self._evaluate(z, self._polynomial[:2])

    def _evaluate(self, z: Float, polynomial: Float) -> NDArray[np.float32]:
        t = (np.asarray(z, np.float32) - np.float32(self._z_middle)) / np.float32(self._z_half)
        out: NDArray[np.float32] = polynomial[:, _ORDER].copy()
        for order in range(_ORDER - 1, -1, -1):
            out *= t
            out += polynomial[:, order]
        return out

    def sees(self, X: Float, Y: Float) -> NDArray[np.bool_]:
        """Return a mask, True where X, Y (px of the binned image) lies inside this image."""
        w, h = self.camera.size
        with np.errstate(invalid="ignore"):
            return (X >= 0) & (X <= w - 1) & (Y >= 0) & (Y <= h - 1)


_MIN_NODES = 3  # along each side of the grid: slopes need three
_MIN_BLOCKS = 8  # along each side of the common view
_MARGIN_BLOCKS = 4  # around the nodes, for the windows of the outermost blocks
_LENS_BLUR_PX = 0.6  # standard deviation of the blur of a usual lens


@dataclass(frozen=True)
class RectifiedView:
    """Pixel maps, masks and blur that rectify the images of one camera to the plane z = 0."""

    maps: tuple[Float, Float]  # (row, column): position of each rectified pixel in the image (`sight_map`)
    visible: NDArray[np.bool_]  # (row, column): True where the camera sees the plane
    visible_blocks: NDArray[np.float32]  # (ny, nx): visible fraction of every block
    mask: Mask  # `visible`, prepared for matching
    blur: tuple[float, float]  # std along x and y of the blur that makes beads alike in all cameras, px


def fit_plane(
    cameras: Sequence[Camera], x: Float, y: Float, z_range: tuple[float, float], pixel: float
) -> tuple[tuple[float, float], tuple[int, int]]:
    """Choose the rectangle of the plane z = 0 to which images are rectified; cameras[0] is the reference.
    Returns a tuple: position (x, y) of its first pixel, metres, and number of its blocks (ny, nx). It
    contains all points where sight lines to the nodes x, y (ny, nx) meet z = 0, for nodes that two cameras
    see and any z in `z_range`. `pixel` is the side of a pixel, m."""
    if min(x.shape) < _MIN_NODES:
        raise RigError(
            f"the grid has {x.shape[1]} x {x.shape[0]} nodes, and slopes need {_MIN_NODES} along each side: "
            "enlarge `grid`, or lower its step"
        )
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
    # beyond the second widest of the views, no two cameras see the plane
    lo = np.maximum(lo, np.sort([view.min(axis=0) for view in views], axis=0)[1])
    hi = np.minimum(hi, np.sort([view.max(axis=0) for view in views], axis=0)[-2])
    if not (hi > lo).all():
        raise RigError("no two cameras see the grid: does the grid lie in the cameras' view?")
    blocks = np.ceil((hi - lo) / (BLOCK * pixel))
    if blocks.min() < _MIN_BLOCKS:
        width, height = 1e3 * (hi - lo)
        raise RigError(
            f"the grid is too small: two cameras see {width:.3g} mm by {height:.3g} mm of it, and matching "
            f"needs {1e3 * _MIN_BLOCKS * BLOCK * pixel:.3g} mm along each side; enlarge `grid`, or "
            "leave it out"
        )
    nx, ny = (int(scipy.fft.next_fast_len(int(n) + 2 * _MARGIN_BLOCKS)) for n in blocks)
    x0, y0 = 0.5 * (lo + hi) - 0.5 * pixel * (np.array([nx, ny]) * BLOCK - 1)
    return (float(x0), float(y0)), (ny, nx)


def _reach(camera: Camera, edge: Float) -> Float:
    """Return points (n, 2), metres, around the part of the plane z = 0 that a camera sees.
    If it sees the horizon, visible points of `edge` (m, 2), metres, the edge of the grid, are included."""
    view = view_on_water(camera)
    if np.isfinite(camera.corners()).all():
        return view
    return np.concatenate([view, edge[camera.sees(edge[:, 0], edge[:, 1], 0.0)]])


def rectified_views(
    sights: Mapping[str, Sight],
    x: Float,
    y: Float,
    pixel: float,
    middle: tuple[float, float],
    stereo: MatchSettings,
) -> dict[str, RectifiedView]:
    """Return, by camera, the view with rectified pixels at x (w,), y (h,) and of the side `pixel`, metres.
    `middle` (x, y) of the grid is in metres; `stereo` are the settings of matching between cameras."""
    blur, shape = _blur(sights, pixel, middle), (x.size // BLOCK, y.size // BLOCK)
    out = {}
    for name, sight in sights.items():
        X, Y, visible = sight_map(sight.camera, x, y)
        blocks = cv2.resize(visible.astype(np.float32), shape, interpolation=cv2.INTER_AREA)
        out[name] = RectifiedView(
            (X, Y), visible, np.asarray(blocks, np.float32), Mask.of(visible, stereo), blur[name]
        )
    return out


def _blur(
    sights: Mapping[str, Sight], pixel: float, middle: tuple[float, float]
) -> dict[str, tuple[float, float]]:
    """Return, by camera, the blur (std along x and y, px) that makes beads equally wide in all views.
    Without this blur, an oblique camera would show beads stretched along its view, which biases z. The side
    of a `pixel` and the grid's `middle` (x, y) are in metres."""
    variances = {}
    for name, sight in sights.items():
        side = np.linalg.inv(sight.camera.jacobian(*middle, 0.0)[:, :2]) / pixel
        # variances, px^2: of the lens, of the pixel, and of the spline that samples the image
        sensor = (_LENS_BLUR_PX / sight.binning) ** 2 + 1.0 / 12.0 + 6.0 / 12.0
        sensor += 0.25 * (sight.binning > 1)  # the Gaussian of `bin_pixels`, half a binned pixel wide
        variances[name] = sensor * np.sum(side**2, axis=1)
    widest = np.max(list(variances.values()), axis=0)
    blur = {name: np.sqrt(widest - own) for name, own in variances.items()}
    return {name: (float(s[0]), float(s[1])) for name, s in blur.items()}


Pixels = NDArray[np.bool_]


@dataclass(frozen=True)
class Covered:
    """Mask of one camera's image, prepared for matching between frames and for matching between cameras."""

    raw: Mask  # of the binned image, for matching in time
    flat: Mask | None  # of the rectified image; None for a camera that does not measure z

    def at(self, X: NDArray[Any], Y: NDArray[Any]) -> Pixels:
        """Return a mask, True where the block around X, Y, px, is in the image and has a masked pixel."""
        whole = self.raw.levels[0]
        h, w = whole.shape
        with np.errstate(invalid="ignore"):
            inside = (X >= 0) & (X <= w - 1) & (Y >= 0) & (Y <= h - 1)
        column = np.rint(np.where(inside, X, 0)).astype(np.intp)
        row = np.rint(np.where(inside, Y, 0)).astype(np.intp)
        return np.asarray(inside & (whole[row, column] == 0))


# Relative variances of u, v, w in deep-water waves from all directions: circular orbits have as much
# horizontal as vertical motion.
WAVE_VARIANCES = np.array([0.5, 0.5, 1.0])
Pair = tuple[str, str]
Outlines = tuple[tuple[tuple[float, float], ...], ...]

_Z_RANGE = 0.02  # default range of elevations, up and down, over the distance of the reference
_SPARE_PX = 2.0  # margin of the search range for displacements, around the parallax of these elevations


class GridGeometry:
    """Geometry of a rig above a grid, computed once for all frames.

    Parameters
    ----------
    rig : Rig
        The cameras.
    grid : Grid
        The nodes of all results.
    settings : Settings, optional
        Settings of the measurement. Default: `Settings()`.
    covered : tuple of ((x, y), ...)
        Outlines of objects in the water, metres, inside which nodes are masked.

    Raises
    ------
    ExperimentError
        If the settings name a camera that is not in the rig, or the pairs have no camera in common.
    RigError
        If the cameras have no common view of the grid.
    """

    def __init__(
        self, rig: Rig, grid: Grid, settings: Settings | None = None, covered: Outlines = ()
    ) -> None:
        self.rig, self.grid, self.covered = rig, grid, covered
        self.settings = settings = settings or Settings()
        if len(rig) < 2:
            raise RigError("a rig needs at least two cameras to measure a surface")
        for name in {name for pair in settings.pairs for name in pair} | set(settings.velocity_cameras):
            if name not in rig.cameras:
                raise ExperimentError(f"the rig has no camera {name!r}; it has {', '.join(rig)}")
        # pairs of cameras that measure z, the reference first in each; cameras that measure u, v, w
        self.pairs = _with_reference_first(settings.pairs) if settings.pairs else pairs_of(rig, tuple(rig))
        self.velocity_cameras = settings.velocity_cameras or tuple(rig)

        distance = float(np.linalg.norm(rig[self.reference].centre - [*self.middle, 0.0]))
        # lowest and highest elevation that is searched, metres
        reach = settings.sheet_thickness or _Z_RANGE * distance
        self.z_range = settings.z_range or (-reach, reach)
        self._check_view()
        coarsest = max(pixel_at(rig[name], *self.middle) for name in self.cameras)
        self.sights: dict[str, Sight] = {}  # image positions of the nodes in every measuring camera
        for name in self.cameras:  # bin the images of finer cameras to about the coarsest pixel on the water
            binning = max(1, round(coarsest / pixel_at(rig[name], *self.middle)))
            self.sights[name] = Sight(rig[name], binning, self.x, self.y, self.z_range)
        cameras = [rig[name] for name in self.surface_cameras]
        # rectified images: side of a pixel, x and y of the first pixel, lattice of the blocks, all in metres
        self.pixel = settings.pixel or self._fitting_pixel()
        self.origin, shape = fit_plane(cameras, self.x, self.y, self.z_range, self.pixel)
        x0, y0 = (first + 0.5 * (BLOCK - 1) * self.pixel for first in self.origin)
        self.lattice = BlockLattice(x0, y0, BLOCK * self.pixel, shape)
        x, y = (first + self.pixel * np.arange(n * BLOCK) for first, n in zip(self.origin, shape[::-1]))
        surface_sights = {name: self.sights[name] for name in self.surface_cameras}
        # maps and masks of every camera that measures z
        self.views = rectified_views(surface_sights, x, y, self.pixel, self.middle, settings.stereo)
        self.prepared_masks: dict[str, tuple[Pixels, Covered]] = {}  # the last mask of each camera

    def __reduce__(self) -> tuple[object, ...]:  # a process that loads the pickle computes the rest, once
        return _cached, (tuple(self.rig.cameras.items()), self.grid, self.settings, self.covered)

    @property
    def reference(self) -> str:
        """Name of the reference camera, which belongs to every pair that measures z."""
        return self.pairs[0][0]

    @property
    def surface_cameras(self) -> tuple[str, ...]:
        """Names of the cameras that measure z, the reference first."""
        return (self.reference, *(b for _, b in self.pairs))

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras that measure z or velocities, in the order of the rig."""
        return tuple(n for n in self.rig if n in self.surface_cameras or n in self.velocity_cameras)

    @property
    def z_is_known(self) -> bool:
        """True for particles in a light sheet on z = 0, False for a water surface.
        In a sheet, cameras are matched in time only, z and its change are 0, and the gain of z is NaN."""
        return self.settings.sheet_thickness is not None

    @property
    def wave_variances(self) -> Float:
        """Variances (3,) of u, v, w relative to each other, in waves that the prior suppresses.
        They are 1, 1, 1 in a light sheet and 0.5, 0.5, 1 on water."""
        return np.ones(3) if self.z_is_known else WAVE_VARIANCES

    @property
    def middle(self) -> tuple[float, float]:
        """Coordinates (x, y) of the middle of the grid, metres."""
        return 0.5 * (self.grid.x[0] + self.grid.x[1]), 0.5 * (self.grid.y[0] + self.grid.y[1])

    @cached_property
    def x(self) -> Float:
        """x of the nodes, (ny, nx), metres."""
        return np.asarray(np.meshgrid(self.grid.x_nodes, self.grid.y_nodes)[0])

    @cached_property
    def y(self) -> Float:
        """y of the nodes, (ny, nx), metres."""
        return np.asarray(np.meshgrid(self.grid.x_nodes, self.grid.y_nodes)[1])

    @cached_property
    def covered_nodes(self) -> NDArray[np.bool_]:
        """Mask (ny, nx), True for nodes inside or on one of the outlines `covered`."""
        out = np.zeros(self.x.shape, bool)
        for outline in self.covered:
            line = np.array(outline, np.float32)
            low, high = line.min(axis=0), line.max(axis=0)
            near = (self.x >= low[0]) & (self.x <= high[0]) & (self.y >= low[1]) & (self.y <= high[1])
            points = np.stack([self.x[near], self.y[near]], axis=-1).tolist()
            out[near] |= [cv2.pointPolygonTest(line, point, False) >= 0 for point in points]
        return out

    def stereo_settings(self, pair: Pair) -> MatchSettings:
        """Return the settings for matching a pair of cameras; the search range follows from `z_range`."""
        a, b = (self.rig[name] for name in pair)
        xa, ya = np.meshgrid(self.lattice.x[[0, -1]], self.lattice.y[[0, -1]])
        ends = []
        for z in self.z_range:
            Dx, Dy = a.sight_line(xa, ya)
            x, y = xa + Dx * z, ya + Dy * z
            Dx, Dy = b.sight_line(x, y, z)
            ends.append((x - Dx * z - xa, y - Dy * z - ya))
        d = np.array(ends) / self.pixel  # (2, 2, ny, nx): height, axis
        ranges = [(float(d[:, i].min() - _SPARE_PX), float(d[:, i].max() + _SPARE_PX)) for i in range(2)]
        settings = self.settings.stereo
        if settings.levels > 1 or settings.search_x is not None:
            settings = replace(settings, search_x=ranges[0], search_y=ranges[1])
        return settings

    def pairs_for(self, present: Sequence[str]) -> tuple[Pair, ...]:
        """Return the pairs with both cameras in `present`; if there is none, new pairs of present cameras."""
        planned = tuple(p for p in self.pairs if p[0] in present and p[1] in present)
        if planned:
            return planned
        rest = tuple(n for n in self.surface_cameras if n in present)
        return pairs_of(self.rig, rest) if len(rest) >= 2 else ()

    def _check_view(self) -> None:
        """Raise RigError unless at least one node is seen by both cameras of a pair."""
        heights = (self.z_range[0], 0.0, self.z_range[1])
        visible = {
            name: np.any([self.rig[name].sees(self.x, self.y, z) for z in heights], axis=0)
            for name in self.surface_cameras
        }
        if not any((visible[a] & visible[b]).any() for a, b in self.pairs):
            raise RigError("no two cameras see the grid: does the grid lie in the cameras' view?")

    def _fitting_pixel(self) -> float:
        """Return the side of a rectified pixel, m: that of the coarsest camera, or at least half of that."""
        own = max(pixel_sides(self.rig[name], *self.middle)[0] for name in self.surface_cameras)
        return max(own / 2.0, min(own, 0.8 * self.grid.step / BLOCK))


def _with_reference_first(pairs: Sequence[Pair]) -> tuple[Pair, ...]:
    """Return the pairs, each with the camera that all pairs share as the first.
    ExperimentError if there is no such camera, or if pairs repeat."""
    common = set.intersection(*(set(pair) for pair in pairs))
    if not common or len({frozenset(p) for p in pairs}) < len(pairs):
        text = ", ".join(f"[{a}, {b}]" for a, b in pairs)
        raise ExperimentError(f"surface: pairs: {text} must differ and share one camera, the reference")
    # of a single pair, the first is the reference
    reference = pairs[0][0] if pairs[0][0] in common else pairs[0][1]
    return tuple((reference, b if a == reference else a) for a, b in pairs)


@lru_cache(maxsize=4)
def _cached(
    cameras: tuple[tuple[str, Camera], ...], grid: Grid, settings: Settings, covered: Outlines
) -> GridGeometry:
    return GridGeometry(Rig(dict(cameras)), grid, settings, covered)
