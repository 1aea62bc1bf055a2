"""Range of the elevation of the water: a coarse search over the record, before it is measured.

The matching between cameras searches the parallax of a range of elevations. Here that range is found from
the images themselves, once per run, and written into the recipe.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.matching.patch_shifts import shifts
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.measurement_settings import Settings
from wavefield.measurement.rectify import rectify

COARSE_PX = 2  # averaged along each side: how differently cameras see a bead matters less
PATCH_COARSE_PX = 48  # side of the patches that are searched for
MAX_EPIPOLAR_COARSE_PX = 5.0
SEARCH_FACTOR = 5.0  # on the usual range of elevations
MAX_FILLED_RANGE = 0.6  # of the usual range in samples: water that fills more exceeds it in a long record
MARGIN = 0.3  # of the span that was found, added on either side, or half of the usual range

Read = Callable[[str, int], NDArray[Any] | None]


@dataclass(frozen=True)
class FirstHeights:
    """Range of the elevations over the record."""

    z: tuple[float, float]  # lowest and highest elevation that was found, metres
    found: int  # patches of images that were found in the other camera's, and all that were searched for
    tried: int
    searched: tuple[float, float]  # range that the run searches, metres
    resolution: float = (
        0.0  # of these elevations, a pixel of parallax: coarse where cameras are close together
    )

    @property
    def sentence(self) -> str:
        """The range in words."""
        low, high = (100 * z for z in self.searched)
        digits = max(1, 2 - math.floor(math.log10(high - low))) if high > low else 1
        searched = f"searched {low:+.{digits}f} to {high:+.{digits}f} cm"
        if not self.tried:
            return (
                f"elevation: the images are too small to find its range; {searched}; where water goes "
                "further state z_range"
            )
        if not self.found:
            return (
                f"elevation: none of {self.tried} patches of images is found in another camera's; {searched}"
            )
        coarse = self.resolution > 0.1 * (self.searched[1] - self.searched[0])
        within = f" to within {100 * self.resolution:.2g} cm" if coarse else ""
        lowest, highest = (f"{100 * z:+.{digits}f}" for z in self.z)
        return (
            f"elevation: {lowest} to {highest} cm{within} ({self.found} of {self.tried} patches found in "
            f"another camera's image), {searched}"
        )


def first_heights(read: Read, geometry: GridGeometry, frames: Sequence[int]) -> FirstHeights:
    """Range of the elevations in some frames of a record, from patches of images rectified to z = 0.
    A patch is searched for in another camera's image; the parallax is that of `match_pair`.
    """
    kept: list[NDArray[np.float64]] = []
    tried = 0
    for frame in frames:
        flat: dict[str, NDArray[np.float32]] = {}
        for name in geometry.surface_cameras:
            image = read(name, frame)
            if image is not None:
                flat[name] = _coarse(rectify(np.asarray(image), *geometry.views[name].maps))
        for a, b in geometry.pairs:
            if a in flat and b in flat:
                moved = shifts(flat[a], flat[b], PATCH_COARSE_PX, _reach((a, b), geometry))
                tried += len(moved)
                z = _heights(moved[np.isfinite(moved[:, 0])], (a, b), geometry)
                confirmed = np.abs(z[:, None] - z) < _agreement(geometry)
                kept.append(z[confirmed.sum(axis=0) > 1])
    found = np.concatenate(kept) if kept else np.zeros(0)
    ends = (float(found.min()) + 0.0, float(found.max()) + 0.0) if len(found) else (0.0, 0.0)  # no -0
    return FirstHeights(ends, len(found), tried, geometry.z_range, _resolution(geometry))


def _resolution(geometry: GridGeometry) -> float:
    """Elevation by which the parallax changes by a coarse pixel in the middle of the field, metres."""
    x, y = float(np.mean(geometry.grid.x)), float(np.mean(geometry.grid.y))
    step = COARSE_PX * geometry.pixel
    lines = {name: np.array(geometry.rig[name].sight_line(x, y)) for name in geometry.surface_cameras}
    return max((step / float(np.hypot(*(lines[b] - lines[a]))) for a, b in geometry.pairs), default=0.0)


def _reach(pair: tuple[str, str], geometry: GridGeometry) -> tuple[int, int]:
    """Largest parallax along x and along y of the elevations searched here, coarse px."""
    x, y = np.meshgrid(geometry.lattice.x[[0, -1]], geometry.lattice.y[[0, -1]])
    (Ax, Ay), (Bx, By) = (geometry.rig[name].sight_line(x, y) for name in pair)
    height = SEARCH_FACTOR * max(abs(z) for z in geometry.z_range) / (COARSE_PX * geometry.pixel)
    along = (int(height * np.abs(b - a).max() + 2 * MAX_EPIPOLAR_COARSE_PX) for a, b in ((Ax, Bx), (Ay, By)))
    return next(along), next(along)


def _agreement(geometry: GridGeometry) -> float:
    """Elevations closer than this confirm each other, metres."""
    return max(0.25 * (geometry.z_range[1] - geometry.z_range[0]), 12 * geometry.pixel)


def _coarse(image: NDArray[Any]) -> NDArray[np.float32]:
    small = cv2.resize(
        image.astype(np.float32), None, fx=1 / COARSE_PX, fy=1 / COARSE_PX, interpolation=cv2.INTER_AREA
    )
    return np.asarray(small, np.float32)


def _heights(
    moved: NDArray[np.float64], pair: tuple[str, str], geometry: GridGeometry
) -> NDArray[np.float64]:
    """Elevations of patches (n, 5) from `shifts`, metres, without those of large epipolar error."""
    step = COARSE_PX * geometry.pixel
    half = 0.5 * (COARSE_PX - 1) * geometry.pixel
    x, y = (origin + half + step * at for origin, at in zip(geometry.plane.origin, moved[:, 3:].T))
    dx, dy = step * moved[:, 0], step * moved[:, 1]
    Ax, Ay = geometry.rig[pair[0]].sight_line(x, y)
    Bx, By = geometry.rig[pair[1]].sight_line(x + dx, y + dy)
    px, py = Bx - Ax, By - Ay
    square = px * px + py * py
    with np.errstate(invalid="ignore", divide="ignore"):
        z = -(px * dx + py * dy) / square
        across = (py * dx - px * dy) / np.sqrt(square)
    out: NDArray[np.float64] = z[np.isfinite(z) & (np.abs(across) < MAX_EPIPOLAR_COARSE_PX * step)]
    return out


def high_enough(settings: Settings, found: FirstHeights) -> tuple[Settings, FirstHeights]:
    """Settings whose search includes the elevations of the water."""
    low, high = found.searched
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if not found.found or all(abs(z - middle) < MAX_FILLED_RANGE * half for z in found.z):
        return settings, found
    margin = max(MARGIN * (found.z[1] - found.z[0]), 0.5 * half, found.resolution)
    wide = (round(found.z[0] - margin, 4), round(found.z[1] + margin, 4))
    return replace(settings, z_range=wide), replace(found, searched=wide)
