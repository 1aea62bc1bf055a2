"""Search ranges of displacements and elevations, found in some frames before a record is measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.matching.patch_shifts import confirmed, shifts, widened
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.images import ready, usable
from wavefield.measurement.rectify import rectify
from wavefield.measurement.settings import Settings


@dataclass(frozen=True)
class FirstGuess:
    """Range of the displacements from frame to frame, from a coarse search with large patches."""

    x: tuple[float, float]  # smallest and largest displacement along x, px of the binned image
    y: tuple[float, float]  # the same along y
    found: int  # patches that were found in the next frame
    tried: int  # patches that were searched for

    def search(self, usual: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Return the ranges to search along x and y, px; None if `usual` suffices or no patch was found."""
        if not self.found:
            return None
        if all(low >= usual[0] and high <= usual[1] for low, high in (self.x, self.y)):
            return None
        return widened(self.x), widened(self.y)

    @property
    def sentence(self) -> str:
        """The range of displacements as a sentence for the user."""
        if self.found < 0.1 * self.tried:
            return (
                f"motion: only {self.found} of {self.tried} patches of images are found in the next frame; "
                "are frames of one camera in order, bright and seeded, and the step short enough?"
            )
        along = (f"{low:+.0f} to {high:+.0f} px" for low, high in (self.x, self.y))
        return (
            f"motion: {next(along)} along x, {next(along)} along y from frame to frame "
            f"({self.found} of {self.tried} test patches matched)"
        )


def first_guess(
    read: Callable[[str, int], NDArray[np.float32] | None], cameras: Sequence[str], steps: Sequence[int]
) -> FirstGuess:
    """Find the range of displacements in some steps, by correlating large patches of images.
    `read(camera, frame)` returns an image or None. Only displacements that another patch confirms count.
    Without any, the range is 0."""
    kept: list[NDArray[np.float64]] = []
    tried = 0
    for step in steps:
        for name in cameras:
            a, b = read(name, step), read(name, step + 1)
            if a is None or b is None:
                continue
            moved = shifts(np.asarray(a, np.float32), np.asarray(b, np.float32))
            tried += len(moved)
            kept.append(confirmed(moved[:, :2]))
    found = np.concatenate(kept) if kept else np.zeros((0, 2))
    if not len(found):
        return FirstGuess((0.0, 0.0), (0.0, 0.0), 0, tried)
    (x0, y0), (x1, y1) = found.min(axis=0).tolist(), found.max(axis=0).tolist()
    return FirstGuess((x0, x1), (y0, y1), len(found), tried)


def wide_enough(settings: Settings, guess: FirstGuess) -> Settings:
    """Return the settings with a search range that includes the displacements of `guess`.
    The same object is returned if its range suffices."""
    piv = settings.piv
    wide = guess.search(searched(settings)[0])
    if wide is None:
        return settings
    return replace(settings, piv=replace(piv, search_x=wide[0], search_y=wide[1]))


def searched(settings: Settings) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the displacements, px, that matching in time covers: (lowest, highest) along x and y."""
    reach = (-4.0, 4.0)  # px: what the pyramid covers without a search
    return settings.piv.search_x or reach, settings.piv.search_y or reach


COARSE_PX = 2  # side of a coarse pixel, rectified px: differences between the cameras' beads matter less
PATCH_COARSE_PX = 48  # side of the patches, coarse px
MAX_EPIPOLAR_COARSE_PX = 5.0  # largest epipolar error of a patch, coarse px
SEARCH_FACTOR = 5.0  # elevations searched here, over the geometry's range
MAX_FILLED_RANGE = 0.6  # widen the range if sample frames fill more of it; a long record would exceed it
MARGIN = 0.3  # added on either side, over the span that was found; at least half of the previous half range

Read = Callable[[str, int], NDArray[Any] | None]


@dataclass(frozen=True)
class FirstHeights:
    """Range of the elevations in some frames, from a coarse search with large patches."""

    z: tuple[float, float]  # lowest and highest elevation that was found, metres
    found: int  # patches that were found in the image of another camera
    tried: int  # patches that were searched for
    searched: tuple[float, float]  # range that the measurement searches, metres
    resolution: float = 0.0  # elevation of one coarse pixel of parallax, metres; large for close cameras

    @property
    def sentence(self) -> str:
        """The range of elevations as a sentence for the user."""
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
    """Find the range of elevations in some frames, from patches of images that are rectified to z = 0.
    Each patch is searched for in the image of another camera, and its elevation follows from the parallax.
    `read(camera, frame)` returns an image or None. Only elevations that another patch confirms count. Without
    any, the range is 0."""
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
    """Return the elevation that causes a parallax of one coarse pixel in the middle of the grid, metres.
    It is the largest over the pairs of cameras; a coarse pixel is two rectified pixels."""
    x, y = float(np.mean(geometry.grid.x)), float(np.mean(geometry.grid.y))
    step = COARSE_PX * geometry.pixel
    lines = {name: np.array(geometry.rig[name].sight_line(x, y)) for name in geometry.surface_cameras}
    return max((step / float(np.hypot(*(lines[b] - lines[a]))) for a, b in geometry.pairs), default=0.0)


def _reach(pair: tuple[str, str], geometry: GridGeometry) -> tuple[int, int]:
    """Return the largest parallax along x and along y for which this pair is searched, in coarse px.
    The elevations are up to five times those of the geometry. A coarse pixel is two rectified pixels."""
    x, y = np.meshgrid(geometry.lattice.x[[0, -1]], geometry.lattice.y[[0, -1]])
    (Ax, Ay), (Bx, By) = (geometry.rig[name].sight_line(x, y) for name in pair)
    height = SEARCH_FACTOR * max(abs(z) for z in geometry.z_range) / (COARSE_PX * geometry.pixel)
    along = (int(height * np.abs(b - a).max() + 2 * MAX_EPIPOLAR_COARSE_PX) for a, b in ((Ax, Bx), (Ay, By)))
    return next(along), next(along)


def _agreement(geometry: GridGeometry) -> float:
    """Return the largest difference, metres, up to which the elevations of two patches confirm each other."""
    return max(0.25 * (geometry.z_range[1] - geometry.z_range[0]), 12 * geometry.pixel)


def _coarse(image: NDArray[Any]) -> NDArray[np.float32]:
    """Return an image with half as many rows and columns, averaged over 2 x 2 px."""
    small = cv2.resize(
        image.astype(np.float32), None, fx=1 / COARSE_PX, fy=1 / COARSE_PX, interpolation=cv2.INTER_AREA
    )
    return np.asarray(small, np.float32)


def _heights(
    moved: NDArray[np.float64], pair: tuple[str, str], geometry: GridGeometry
) -> NDArray[np.float64]:
    """Return the elevations, metres, of patches of a pair of cameras, from their displacements.
    `moved` (n, 5) is the result of `shifts`, in coarse px. Patches with a large epipolar error (a
    displacement that no elevation explains) are left out."""
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
    """Widen the range of elevations in the settings if those found fill more than 0.6 of it.
    Returns the settings, and `found` with the new range; both are the same objects if the range suffices."""
    low, high = found.searched
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if not found.found or all(abs(z - middle) < MAX_FILLED_RANGE * half for z in found.z):
        return settings, found
    margin = max(MARGIN * (found.z[1] - found.z[0]), 0.5 * half, found.resolution)
    wide = (round(found.z[0] - margin, 4), round(found.z[1] + margin, 4))
    return replace(settings, z_range=wide), replace(found, searched=wide)


Images = Mapping[str, NDArray[Any] | None]
SEARCHED_STEPS = 2  # sample steps in which search ranges are found


def search_widened(pairs: Iterable[tuple[Images, Images]], geometry: GridGeometry) -> GridGeometry:
    """Return the geometry with search ranges that suit some frames; the same object if they suffice.
    `pairs` are the first and second frames of sample steps, by camera, of which the first two steps are
    searched; only first frames give elevations. Ranges that the user has set are not changed."""
    searched_pairs = list(islice(pairs, SEARCHED_STEPS))

    def read(name: str, frame: int) -> NDArray[Any] | None:
        image = searched_pairs[frame // 2][frame % 2].get(name)
        if image is None or not usable(image, geometry.rig[name].size):
            return None
        return np.asarray(ready(image, geometry.sights[name].binning))

    first_frames = [2 * k for k in range(len(searched_pairs))]
    settings = geometry.settings
    if searched(settings) == searched(Settings()):
        settings = wide_enough(settings, first_guess(read, geometry.velocity_cameras, first_frames))
    if settings.z_range is None:
        settings, _ = high_enough(settings, first_heights(read, geometry, first_frames))
    if settings == geometry.settings:
        return geometry
    return GridGeometry(geometry.rig, geometry.grid, settings, geometry.covered)


BORDER_FRACTION = 0.03  # part of the search range, at either end, that counts as its border
MIN_FRACTION_AT_BORDER = 0.01  # fraction of the nodes there at which the range is too small


def at_border(z: NDArray[Any], searched: tuple[float, float]) -> bool:
    """Return whether more than 1 % of the elevations z lie within 3 % of an end of a range, or beyond.

    >>> at_border(np.array([[0.01, 0.099], [np.nan, 0.02]]), (-0.1, 0.1))
    True
    """
    known = z[np.isfinite(z)]
    if not known.size:
        return False
    spare = BORDER_FRACTION * (searched[1] - searched[0])
    outside = (known < searched[0] + spare) | (known > searched[1] - spare)
    return bool(outside.mean() > MIN_FRACTION_AT_BORDER)
