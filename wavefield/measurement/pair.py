"""Match the rectified images of two cameras, and match points of still water in all cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.errors import CalibrationError
from wavefield.matching import Reason
from wavefield.matching.blocks import CLUSTER
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.images import prepare, ready, usable
from wavefield.robust import robust_std
from wavefield.variables import Quality

Float = NDArray[Any]

NEVER_REJECTED_PX = 0.3  # epipolar error that is always accepted, because calibrations have as much


@dataclass(frozen=True)
class PairMatch:
    """Displacement between the rectified images of one pair of cameras, on the lattice of blocks."""

    pair: tuple[str, str]  # the cameras (a, b); the lattice is in apparent positions of a
    difference: Float  # (2, ny, nx): d = x_b - x_a, difference of the apparent positions, metres
    parallax: Float  # (2, ny, nx): dD = D_b - D_a, each at its own apparent position
    eps_y: Float  # (ny, nx): epipolar error, metres
    rejected: NDArray[np.uint16]  # (ny, nx): bits of `Quality`: why a block is not valid; 0 if it is
    matched: NDArray[np.bool_]  # (ny, nx): valid except for the test of the epipolar error
    found: matching.Displacement  # the match itself, px

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Mask (ny, nx), True for valid blocks."""
        return np.asarray(self.rejected == 0)

    @property
    def height(self) -> Float:
        """Elevation z = -dD . d / |dD|^2, (ny, nx), metres, from the difference d and the parallax dD."""
        out: Float = -np.sum(self.parallax * self.difference, axis=0)
        out /= np.sum(np.square(self.parallax), axis=0)
        return out

    @property
    def turned(self) -> PairMatch:
        """The match with parallaxes turned by 90 degrees: its `height` contains errors, but no elevation."""
        return replace(self, parallax=quarter_turn(self.parallax))


def quarter_turn(vector: Float) -> Float:
    """Return vectors (2, ny, nx), with components x and y, turned by 90 degrees from x towards y."""
    return np.stack([-vector[1], vector[0]])


def match_pair(
    a: matching.PreparedImage, b: matching.PreparedImage, pair: tuple[str, str], geometry: GridGeometry
) -> PairMatch:
    """Match the rectified images a, b of the cameras `pair`; reject blocks with implausible z or eps_Y.

    A point at the elevation z appears at x_a and x_b, where the sight lines have the slopes D_a and D_b. The
    differences d = x_b - x_a and dD = D_b - D_a give z = -(dD . d) / |dD|^2 and the epipolar error eps_Y =
    (dD_y d_x - dD_x d_y) / |dD|.
    """
    found = matching.match(a, b, geometry.stereo_settings(pair))
    d = np.stack([found.u, found.v]) * np.float32(geometry.pixel)
    x, y = (v.astype(np.float32) for v in np.meshgrid(geometry.lattice.x, geometry.lattice.y))
    centre_a, centre_b = (geometry.rig[name].centre for name in pair)
    parallax = _sight_line(centre_b, x + d[0], y + d[1]) - _sight_line(centre_a, x, y)
    length = np.sqrt(parallax[0] ** 2 + parallax[1] ** 2)
    eps_y = (parallax[1] * d[0] - parallax[0] * d[1]) / length
    z = -(parallax[0] * d[0] + parallax[1] * d[1]) / length**2
    rejected = why_rejected(found.reason)
    rejected[(z < geometry.z_range[0]) | (z > geometry.z_range[1])] |= np.uint16(Quality.REJECTED_RANGE)
    matched = rejected == 0
    if matched.any():
        settings = geometry.settings
        limit = max(settings.eps_limit * robust_std(eps_y[matched]), NEVER_REJECTED_PX * geometry.pixel)
        rejected[np.abs(eps_y) > limit] |= np.uint16(Quality.REJECTED_EPS)
    return PairMatch(pair, d, parallax, eps_y, rejected, matched, found)


def _sight_line(centre: Float, x: Float, y: Float) -> Float:
    """Return the slopes dx/dz, dy/dz of sight lines from a camera's centre to x, y on z = 0, (2, ny, nx)."""
    depth = np.float32(-centre[2])
    return np.stack([(x - np.float32(centre[0])) / depth, (y - np.float32(centre[1])) / depth])


def why_rejected(reason: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return why blocks were rejected, (ny, nx), as bits of `Quality`, from bits of `Reason` in matching."""
    out = np.zeros(reason.shape, np.uint16)
    known = int(Reason.NEIGHBOURS | Reason.RANGE)
    for bits, flag in (
        (~known & 0xFF, Quality.REJECTED_CORRELATION),
        (int(Reason.NEIGHBOURS), Quality.REJECTED_NEIGHBOURS),
        (int(Reason.RANGE), Quality.REJECTED_RANGE),
    ):
        out[(reason & np.uint8(bits)) != 0] |= np.uint16(flag)
    return out


def matched_pixels(
    read: Callable[[str, int], NDArray[Any] | None],
    frames: Sequence[int],
    geometry: GridGeometry,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Match points of still water in all cameras, to level a rig; return their pixels (n, 2) by camera.
    Pixels are (column, row). Point n is the same in all cameras, NaN where its pair does not match.
    `read(camera, frame)` gives an image or None. CalibrationError if no frame is usable in all cameras."""
    rig = geometry.rig
    cells = np.s_[::CLUSTER, ::CLUSTER]  # closer blocks share beads
    x, y = (v[cells] for v in np.meshgrid(geometry.lattice.x, geometry.lattice.y))
    parts: dict[str, list[NDArray[np.float64]]] = {name: [] for name in geometry.surface_cameras}
    for done, index in enumerate(frames, 1):
        images = {name: read(name, index) for name in geometry.surface_cameras}
        if all(usable(image, rig[name].size) for name, image in images.items()):
            flat = {
                name: prepare(ready(np.asarray(image), geometry.sights[name].binning), name, geometry)
                for name, image in images.items()
            }
            valid = np.zeros(x.shape, bool)
            found = {}
            for a, b in geometry.pairs:
                match = match_pair(flat[a], flat[b], (a, b), geometry)
                dx, dy = (np.where(match.matched, d, np.nan)[cells] for d in match.difference)
                found[b] = np.stack(rig[b].project(x + dx, y + dy, 0.0), axis=-1)
                valid |= match.matched[cells]
            found[geometry.reference] = np.stack(rig[geometry.reference].project(x, y, 0.0), axis=-1)
            for name, pixels in found.items():
                parts[name].append(pixels[valid])
        if progress:
            progress(done, len(frames))
    if not any(parts.values()):
        raise CalibrationError(
            f"none of the {len(frames)} frames tried is there, and of the rig's size, in all of "
            f"{', '.join(parts)}: no points to match"
        )
    return {name: np.concatenate(pixels) for name, pixels in parts.items()}
