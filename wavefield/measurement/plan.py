"""Everything that is computed once per rig and grid."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavefield import matching
from wavefield.errors import ExperimentError, RigError
from wavefield.grid import Grid
from wavefield.matching import Modes, PosteriorVariance
from wavefield.matching.matching_kernels import BLOCK
from wavefield.matching.prepared import Mask
from wavefield.measurement.elevation_model import FieldModel
from wavefield.measurement.learned_record import LearnedRecord
from wavefield.measurement.measurement_settings import Settings
from wavefield.measurement.rectify import binned, sight_map
from wavefield.measurement.regrid import BlockLattice
from wavefield.measurement.sight import Sight
from wavefield.rig import Camera, Rig
from wavefield.rig.pairs import pairs_of
from wavefield.rig.resolution import pixel_at, pixel_sides

Outlines = tuple[tuple[tuple[float, float], ...], ...]

_MIN_BLOCKS = 8  # along each side of the common view
_MARGIN = 4  # blocks around the nodes
_LENS = 0.6  # px: blur of a usual lens


class Plan:
    """The measurement of one rig on one grid: maps, lattices, cameras and their parts.

    Parameters
    ----------
    rig : Rig
        The cameras.
    grid : Grid
        Where every quantity is wanted.
    settings : Settings, optional
        The choices; defaults follow from the rig.
    record : Record, optional
        What sample frames of the record say (`learn`). Without it, `measure` learns from the frames it gets.
    covered : tuple of ((x, y), ...)
        Outlines on the water, metres, of what is no water.

    Attributes
    ----------
    pairs : tuple of (str, str)
        Pairs for z, the reference first.
    reference : str
        Camera in whose apparent coordinates the lattice lies.
    surface_cameras, velocity_cameras : tuple of str
        Who measures what.
    pixel : float
        Pixel of the rectified images, metres.
    z_range : (float, float)
        Elevations searched, metres.
    blur : dict of str to (float, float)
        Blur of the rectified images along x and y that makes beads alike, px.
    binning : dict of str to int
        Squares of so many pixels are averaged before anything else: cameras must see beads alike.
    record : Record or None
        What is known of the record.
    sought : Sought
        The elevation; only with a record. Displacements belong to the `Sight` of each camera.

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
        self,
        rig: Rig,
        grid: Grid,
        settings: Settings | None = None,
        record: LearnedRecord | None = None,
        covered: Outlines = (),
    ) -> None:
        self.rig, self.grid, self.covered = rig, grid, covered
        self.record: LearnedRecord | None = None
        self.settings = settings = settings or Settings()
        if len(rig) < 2:
            raise RigError("a rig needs at least two cameras to measure a surface")
        for name in {name for pair in settings.pairs for name in pair} | set(settings.velocity_cameras):
            if name not in rig.cameras:
                raise ExperimentError(f"the rig has no camera {name!r}; it has {', '.join(rig)}")
        self.pairs = _with_reference_first(settings.pairs) if settings.pairs else pairs_of(rig, tuple(rig))
        self.reference = self.pairs[0][0]
        self.surface_cameras = (self.reference, *(b for _, b in self.pairs))
        self.velocity_cameras = settings.velocity_cameras or tuple(rig)
        self.cameras = tuple(n for n in rig if n in self.surface_cameras or n in self.velocity_cameras)

        self.x, self.y = np.meshgrid(grid.x_nodes, grid.y_nodes)
        self.covered_nodes = _inside(self.x, self.y, covered)
        self.covered_before: dict[str, Any] = {}  # masks of cameras, as `covered_in` made them ready
        middle = 0.5 * (grid.x[0] + grid.x[1]), 0.5 * (grid.y[0] + grid.y[1])
        distance = float(np.linalg.norm(rig[self.reference].centre - [*middle, 0.0]))
        reach = settings.sheet_thickness or 0.02 * distance
        self.z_range = settings.z_range or (-reach, reach)
        self.pixel = settings.pixel or self._fitting_pixel(*middle)

        self._check_view()
        self.binning = self._binning(*middle)
        self.binned = {name: binned(rig[name], self.binning[name]) for name in self.cameras}
        self.blur = self._blur(*middle)
        self._lay_out()
        self.sights = {
            name: Sight(camera, self.x, self.y, self.z_range) for name, camera in self.binned.items()
        }
        if record is not None:
            self._use(record)

    def __reduce__(self) -> tuple[Any, ...]:
        return _cached, (
            tuple(self.rig.cameras.items()),
            self.grid,
            self.settings,
            self.record,
            self.covered,
        )

    def with_prior(self, record: LearnedRecord) -> Plan:
        """The same plan with another record.

        Parameters
        ----------
        record : Record
            As given by `learn`.

        Returns
        -------
        Plan
        """
        if record == self.record:
            return self
        out = object.__new__(Plan)  # `copy` would give the cached plan that all share
        out.__dict__.update(self.__dict__)
        out.sights = {name: copy(sight) for name, sight in self.sights.items()}
        out._use(record)
        return out

    def _use(self, record: LearnedRecord) -> None:
        """Seek the fields whose spectra the record has; what is laid out for the same spectrum stays."""
        shape, before = self.lattice.shape, self.record
        if before is None or before.elevation != record.elevation:
            self.field_model = FieldModel(record.elevation, shape, self.settings.smoothing, self._in_view())
        for name, prior in record.displacement:
            self.sights[name].use(prior)
        self.record = record

    @property
    def modes(self) -> Modes:
        """Cosines of the elevation."""
        return self.field_model.modes

    @property
    def spread(self) -> PosteriorVariance:
        """Variance of the elevation."""
        return self.field_model.spread

    def _in_view(self) -> NDArray[np.bool_]:
        """(ny, nx): blocks well inside what the reference and a partner see of the water at rest."""
        others = [self.seen_blocks[name] for name in self.surface_cameras[1:]]
        both = np.minimum(self.seen_blocks[self.reference], np.max(others, axis=0)) > 0.99
        return np.asarray(cv2.erode(both.view(np.uint8), np.ones((15, 15), np.uint8)) > 0)

    def _check_view(self) -> None:
        """Refuse a grid of which no node is seen by two cameras."""
        heights = (self.z_range[0], 0.0, self.z_range[1])
        seen = {
            name: np.any([self.rig[name].sees(self.x, self.y, z) for z in heights], axis=0)
            for name in self.surface_cameras
        }
        if not any((seen[a] & seen[b]).any() for a, b in self.pairs):
            raise RigError("no two cameras see the grid: does the grid lie in the cameras' view?")

    def _fitting_pixel(self, x: float, y: float) -> float:
        """The cameras' own pixel, or finer (at most twice) where blocks would exceed 0.8 grid steps."""
        own = max(pixel_sides(self.rig[name], x, y)[0] for name in self.surface_cameras)
        return max(own / 2.0, min(own, 0.8 * self.grid.step / BLOCK))

    def _binning(self, x: float, y: float) -> dict[str, int]:
        """How much finer than the coarsest each camera resolves: so many pixels are averaged."""
        size = {n: pixel_at(self.rig[n], x, y) for n in self.cameras}
        return {name: max(1, round(max(size.values()) / own)) for name, own in size.items()}

    def _blur(self, x: float, y: float) -> dict[str, tuple[float, float]]:
        """Standard deviations along x and y, px, that make a bead as wide in every rectified image.

        Left alone, an oblique camera's beads are wider across its view, and what is left of a bead after
        matching pulls at the surface as the window passes over it.
        """
        spread = {}
        for name in self.surface_cameras:
            side = np.linalg.inv(self.binned[name].jacobian(x, y, 0.0)[:, :2]) / self.pixel
            # variances in px: the lens, the pixel, the spline by which the image is read
            sensor = (_LENS / self.binning[name]) ** 2 + 1.0 / 12.0 + 6.0 / 12.0
            sensor += 0.25 * (self.binning[name] > 1)  # half a side: what goes before `bin_pixels`
            spread[name] = sensor * np.sum(side**2, axis=1)
        widest = np.max(list(spread.values()), axis=0)
        blur = {name: np.sqrt(widest - own) for name, own in spread.items()}
        return {n: (float(s[0]), float(s[1])) for n, s in blur.items()}

    def _lay_out(self) -> None:
        """The rectified plane: where the nodes appear at any height, and two cameras see them.

        To the reference and to one of its partners: cameras on opposite sides see a node displaced to
        opposite sides, and one of them is enough for what is high or low at the very edge.
        """
        lo, hi = np.full(2, np.inf), np.full(2, -np.inf)
        edge_x = np.concatenate([self.x[0], self.x[-1], self.x[:, 0], self.x[:, -1]])
        edge_y = np.concatenate([self.y[0], self.y[-1], self.y[:, 0], self.y[:, -1]])
        for z in self.z_range:
            own, *others = (
                np.stack(camera.unproject(*camera.project(edge_x, edge_y, z)))
                for camera in (self.rig[name] for name in self.surface_cameras)
            )
            # NaN where a camera does not see the node
            least, most = np.fmax.reduce(others), np.fmin.reduce(others)
            lo = np.fmin(lo, np.fmin.reduce(np.fmin(own, least), axis=1))
            hi = np.fmax(hi, np.fmax.reduce(np.fmax(own, most), axis=1))
        corners = [self.rig[name].corners() for name in self.surface_cameras]
        boxes = [(np.nanmin(c, axis=0), np.nanmax(c, axis=0)) for c in corners]
        # beyond what the second widest of the views reaches, no two cameras see anything
        low, high = np.sort([b[0] for b in boxes], axis=0), np.sort([b[1] for b in boxes], axis=0)
        lo, hi = np.maximum(lo, low[1]), np.minimum(hi, high[-2])
        step = BLOCK * self.pixel
        # and beyond that, the windows of the outermost blocks want their surroundings
        blocks = np.ceil((hi - lo) / step) + 2 * _MARGIN
        if not (blocks >= _MIN_BLOCKS + 2 * _MARGIN).all():
            raise RigError("no two cameras see the grid: does the grid lie in the cameras' view?")
        nx, ny = (int(scipy.fft.next_fast_len(int(n))) for n in blocks)
        centre = 0.5 * (lo + hi)
        x0, y0 = centre - 0.5 * self.pixel * (np.array([nx, ny]) * BLOCK - 1)
        px = x0 + self.pixel * np.arange(nx * BLOCK)
        py = y0 + self.pixel * np.arange(ny * BLOCK)
        middle_of_block = 0.5 * (BLOCK - 1) * self.pixel
        self.origin = (float(x0), float(y0))
        self.lattice = BlockLattice(x0 + middle_of_block, y0 + middle_of_block, step, (ny, nx))
        self.maps: dict[str, tuple[NDArray[Any], NDArray[Any]]] = {}
        self.seen: dict[str, NDArray[Any]] = {}
        self.masks: dict[str, Mask] = {}
        self.seen_blocks: dict[str, NDArray[Any]] = {}
        for name in self.surface_cameras:
            X, Y, seen = sight_map(self.binned[name], px, py)
            self.maps[name], self.seen[name] = (X, Y), seen
            self.masks[name] = Mask.of(seen, self.settings.stereo)
            self.seen_blocks[name] = cv2.resize(
                seen.astype(np.float32), (nx, ny), interpolation=cv2.INTER_AREA
            )
        if not any((self.seen[a] & self.seen[b]).any() for a, b in self.pairs):
            raise RigError("no pair of cameras sees the grid in common: does the grid lie in their view?")
        # what a block means in metres, per camera: its sight line
        x, y = np.meshgrid(self.lattice.x, self.lattice.y)
        self.block_x, self.block_y = x.astype(np.float32), y.astype(np.float32)
        self.stereo = {pair: self._search(pair) for pair in self.pairs}

    def stereo_settings(self, pair: tuple[str, str]) -> matching.MatchSettings:
        """Matching settings of a pair, its search range from the elevations searched."""
        if pair not in self.stereo:
            self.stereo[pair] = self._search(pair)
        return self.stereo[pair]

    def _search(self, pair: tuple[str, str]) -> matching.MatchSettings:
        a, b = (self.rig[name] for name in pair)
        xa, ya = np.meshgrid(self.lattice.x[[0, -1]], self.lattice.y[[0, -1]])
        ends = []
        for z in self.z_range:
            Dx, Dy = a.sight_line(xa, ya)
            x, y = xa + Dx * z, ya + Dy * z
            Dx, Dy = b.sight_line(x, y, z)
            ends.append((x - Dx * z - xa, y - Dy * z - ya))
        d = np.array(ends) / self.pixel  # (2, 2, ny, nx): height, axis
        spare = 2.0
        ranges = [(float(d[:, i].min() - spare), float(d[:, i].max() + spare)) for i in range(2)]
        settings = self.settings.stereo
        if settings.levels > 1 or settings.search_x is not None:
            settings = replace(settings, search_x=ranges[0], search_y=ranges[1])
        return settings

    def parallaxes(self, pairs: Sequence[tuple[str, str]]) -> NDArray[Any]:
        """Length of the parallax of pairs with one reference in the middle of the grid.

        Parameters
        ----------
        pairs : sequence of (str, str)
            The reference first.

        Returns
        -------
        ndarray, (P,)
            Metres per metre of elevation; negative on the other side of the reference than the first.
        """
        x, y = 0.5 * (self.grid.x[0] + self.grid.x[1]), 0.5 * (self.grid.y[0] + self.grid.y[1])
        lean = {n: np.array(self.rig[n].sight_line(x, y), float) for pair in pairs for n in pair}
        parallax = np.array([lean[b] - lean[a] for a, b in pairs])
        out: NDArray[Any] = np.hypot(*parallax.T) * np.where(parallax @ parallax[0] < 0.0, -1.0, 1.0)
        return out

    def pairs_for(self, present: Sequence[str]) -> tuple[tuple[str, str], ...]:
        """Pairs that can work when only some cameras have a frame.

        Parameters
        ----------
        present : sequence of str
            Cameras with a usable frame.

        Returns
        -------
        tuple of (str, str)
            The planned pairs among them; without the reference, pairs of the others; empty if fewer than two.
        """
        planned = tuple(p for p in self.pairs if p[0] in present and p[1] in present)
        if planned:
            return planned
        rest = tuple(n for n in self.surface_cameras if n in present)
        return pairs_of(self.rig, rest) if len(rest) >= 2 else ()


def _inside(x: NDArray[Any], y: NDArray[Any], outlines: Outlines) -> NDArray[np.bool_]:
    """Nodes inside or on closed outlines, (ny, nx)."""
    out = np.zeros(x.shape, bool)
    for outline in outlines:
        line = np.array(outline, np.float32)
        low, high = line.min(axis=0), line.max(axis=0)
        near = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
        points = np.stack([x[near], y[near]], axis=-1).tolist()
        out[near] |= [cv2.pointPolygonTest(line, point, False) >= 0 for point in points]
    return out


def _with_reference_first(pairs: Sequence[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    common = set(pairs[0])
    for pair in pairs:
        common &= set(pair)
    if not common or len({frozenset(p) for p in pairs}) < len(pairs):
        text = ", ".join(f"[{a}, {b}]" for a, b in pairs)
        raise ExperimentError(f"surface: pairs: {text} must differ and share one camera, the reference")
    # of a single pair, the first is the reference
    reference = pairs[0][0] if pairs[0][0] in common else pairs[0][1]
    return tuple((reference, b if a == reference else a) for a, b in pairs)


@lru_cache(maxsize=4)
def _cached(
    cameras: tuple[tuple[str, Camera], ...],
    grid: Grid,
    settings: Settings,
    record: LearnedRecord | None,
    covered: Outlines,
) -> Plan:
    return Plan(Rig(dict(cameras)), grid, settings, record, covered)
