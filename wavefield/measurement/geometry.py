"""What follows from rig, grid and settings alone: which cameras measure what, lattices, maps, sight lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError, RigError
from wavefield.grid import Grid
from wavefield.matching import MatchSettings
from wavefield.matching.matching_kernels import BLOCK
from wavefield.measurement.covered import Covered, Pixels
from wavefield.measurement.measurement_settings import Settings
from wavefield.measurement.rectified_view import RectifiedPlane, RectifiedView, fit_plane, rectified_views
from wavefield.measurement.regrid import BlockLattice
from wavefield.measurement.sight import Sight
from wavefield.rig import Camera, Rig
from wavefield.rig.pairs import pairs_of
from wavefield.rig.resolution import pixel_at, pixel_sides

Float = NDArray[np.floating]
Pair = tuple[str, str]
Outlines = tuple[tuple[tuple[float, float], ...], ...]

_Z_RANGE = 0.02  # of the reference camera's distance: elevations searched up and down by default
_SPARE_PX = 2.0  # beyond the parallax of the elevations searched


class GridGeometry:
    """A rig above a grid, and what follows from them and the settings alone.

    Parameters
    ----------
    rig : Rig
        The cameras.
    grid : Grid
        Nodes of all results.
    settings : Settings, optional
        The choices; defaults follow from the rig.
    covered : tuple of ((x, y), ...)
        Outlines on the water, metres, of what is no water.

    Attributes
    ----------
    pairs : tuple of (str, str)
        Pairs for z, the reference first.
    velocity_cameras : tuple of str
        Cameras whose displacements give u, v, w.
    z_range : (float, float)
        Elevations searched, metres.
    plane : RectifiedPlane
        Pixels of the rectified images, in apparent coordinates of the reference.
    views : dict of str to RectifiedView
        Maps and masks of the cameras that measure z.
    sights : dict of str to Sight
        Where each measuring camera sees the nodes, and its binning.

    Raises
    ------
    ExperimentError
        If a camera is named that the rig does not have, or the pairs have no camera in common.
    RigError
        If the cameras have no common view of the grid.

    Notes
    -----
    Pickles as its parameters; the copy is computed anew, once per process.
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
        self.pairs = _with_reference_first(settings.pairs) if settings.pairs else pairs_of(rig, tuple(rig))
        self.velocity_cameras = settings.velocity_cameras or tuple(rig)

        distance = float(np.linalg.norm(rig[self.reference].centre - [*self.middle, 0.0]))
        reach = settings.sheet_thickness or _Z_RANGE * distance
        self.z_range = settings.z_range or (-reach, reach)
        self._check_view()
        coarsest = max(pixel_at(rig[name], *self.middle) for name in self.cameras)
        self.sights = {}
        for name in self.cameras:  # binned so that all cameras see beads alike
            binning = max(1, round(coarsest / pixel_at(rig[name], *self.middle)))
            self.sights[name] = Sight(rig[name], binning, self.x, self.y, self.z_range)
        cameras = [rig[name] for name in self.surface_cameras]
        pixel = settings.pixel or self._fitting_pixel()
        self.plane: RectifiedPlane = fit_plane(cameras, self.x, self.y, self.z_range, pixel)
        surface_sights = {name: self.sights[name] for name in self.surface_cameras}
        self.views: dict[str, RectifiedView] = rectified_views(
            surface_sights, self.plane, self.middle, settings.stereo
        )
        if not any((self.views[a].visible & self.views[b].visible).any() for a, b in self.pairs):
            raise RigError("no pair of cameras sees the grid in common: does the grid lie in their view?")
        self.prepared_masks: dict[str, tuple[Pixels, Covered]] = {}  # the last of each camera

    def __reduce__(self) -> tuple[object, ...]:
        return _cached, (tuple(self.rig.cameras.items()), self.grid, self.settings, self.covered)

    @property
    def reference(self) -> str:
        """Camera in whose apparent coordinates the lattice is defined."""
        return self.pairs[0][0]

    @property
    def surface_cameras(self) -> tuple[str, ...]:
        """Cameras that measure z, the reference first."""
        return (self.reference, *(b for _, b in self.pairs))

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras that measure anything, in the order of the rig."""
        return tuple(n for n in self.rig if n in self.surface_cameras or n in self.velocity_cameras)

    @property
    def middle(self) -> tuple[float, float]:
        """Middle of the grid, metres."""
        return 0.5 * (self.grid.x[0] + self.grid.x[1]), 0.5 * (self.grid.y[0] + self.grid.y[1])

    @property
    def pixel(self) -> float:
        """Pixel of the rectified images, metres."""
        return self.plane.pixel

    @property
    def lattice(self) -> BlockLattice:
        """Blocks of the rectified images, metres, in apparent coordinates of the reference."""
        return self.plane.lattice

    @cached_property
    def x(self) -> Float:
        """Nodes, (ny, nx), metres."""
        return np.asarray(np.meshgrid(self.grid.x_nodes, self.grid.y_nodes)[0])

    @cached_property
    def y(self) -> Float:
        """Nodes, (ny, nx), metres."""
        return np.asarray(np.meshgrid(self.grid.x_nodes, self.grid.y_nodes)[1])

    @cached_property
    def covered_nodes(self) -> NDArray[np.bool_]:
        """Nodes inside or on the outlines of what is no water, (ny, nx)."""
        out = np.zeros(self.x.shape, bool)
        for outline in self.covered:
            line = np.array(outline, np.float32)
            low, high = line.min(axis=0), line.max(axis=0)
            near = (self.x >= low[0]) & (self.x <= high[0]) & (self.y >= low[1]) & (self.y <= high[1])
            points = np.stack([self.x[near], self.y[near]], axis=-1).tolist()
            out[near] |= [cv2.pointPolygonTest(line, point, False) >= 0 for point in points]
        return out

    def stereo_settings(self, pair: Pair) -> MatchSettings:
        """Matching settings of a pair, its search range from the elevations searched."""
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
        """Pairs among the cameras that have a frame; without the reference, pairs of the others."""
        planned = tuple(p for p in self.pairs if p[0] in present and p[1] in present)
        if planned:
            return planned
        rest = tuple(n for n in self.surface_cameras if n in present)
        return pairs_of(self.rig, rest) if len(rest) >= 2 else ()

    def _check_view(self) -> None:
        """Refuse a grid of which no node is seen by two cameras."""
        heights = (self.z_range[0], 0.0, self.z_range[1])
        visible = {
            name: np.any([self.rig[name].sees(self.x, self.y, z) for z in heights], axis=0)
            for name in self.surface_cameras
        }
        if not any((visible[a] & visible[b]).any() for a, b in self.pairs):
            raise RigError("no two cameras see the grid: does the grid lie in the cameras' view?")

    def _fitting_pixel(self) -> float:
        """The cameras' own pixel, or finer (at most twice) where blocks would exceed 0.8 grid steps."""
        own = max(pixel_sides(self.rig[name], *self.middle)[0] for name in self.surface_cameras)
        return max(own / 2.0, min(own, 0.8 * self.grid.step / BLOCK))


def _with_reference_first(pairs: Sequence[Pair]) -> tuple[Pair, ...]:
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
