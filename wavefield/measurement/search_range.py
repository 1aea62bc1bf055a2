"""Search ranges of displacements and elevations, found in some frames before a record is measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.patch_shifts import confirmed, shifts, widened
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.images import ready, usable
from wavefield.measurement.rectify import rectify
from wavefield.measurement.settings import Settings

Images = Mapping[str, NDArray[Any] | None]
Range = tuple[float, float]
Read = Callable[[str, int], NDArray[Any] | None]  # read(camera, frame): an image, or None

SEARCHED_STEPS = 2  # sample steps in which search ranges are found, if no model is given
MAX_EPIPOLAR_PX = 10.0  # largest epipolar error of a patch, rectified px
SEARCH_FACTOR = 5.0  # elevations searched here, over the geometry's range
MAX_FILLED_RANGE = 0.6  # widen the range if sample frames fill more of it; a long record would exceed it
BORDER_FRACTION = 0.03  # part of the search range, at either end, that counts as its border
MIN_FRACTION_AT_BORDER = 0.01  # fraction of the nodes there at which the range is too small


@dataclass(frozen=True)
class FirstGuess:
    """Range of the displacements from frame to frame, from a coarse search with large patches."""

    x: Range  # smallest and largest displacement along x, px of the binned image
    y: Range  # the same along y
    found: int  # patches that were found in the next frame
    tried: int  # patches that were searched for

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


def first_guess(read: Read, cameras: Sequence[str], steps: Sequence[int]) -> FirstGuess:
    """Find the range of displacements in some steps, by a search for large patches in the next frame.
    A displacement counts if another patch confirms it. `read(camera, frame)` gives an image or None."""
    kept: list[NDArray[np.float64]] = [np.zeros((0, 2))]
    tried = 0
    for step in steps:
        for name in cameras:
            a, b = read(name, step), read(name, step + 1)
            if a is not None and b is not None:
                moved = shifts(np.asarray(a, np.float32), np.asarray(b, np.float32))
                tried += len(moved)
                kept.append(confirmed(moved[:, :2]))
    found = np.concatenate(kept)
    (x0, y0), (x1, y1) = (found.min(axis=0), found.max(axis=0)) if len(found) else np.zeros((2, 2))
    return FirstGuess((float(x0), float(x1)), (float(y0), float(y1)), len(found), tried)


def wide_enough(settings: Settings, guess: FirstGuess) -> Settings:
    """Return settings whose search ranges contain `guess`; the same object if they contain it already."""
    low, high = settings.piv.search_x or (-4.0, 4.0)  # px: what the pyramid covers without a search
    if not guess.found or (low <= min(guess.x[0], guess.y[0]) and max(guess.x[1], guess.y[1]) <= high):
        return settings
    wide = replace(settings.piv, search_x=widened(guess.x), search_y=widened(guess.y))
    return replace(settings, piv=wide)


@dataclass(frozen=True)
class FirstHeights:
    """Range of the elevations in some frames, from a coarse search with large patches."""

    z: Range  # lowest and highest elevation that was found, metres
    found: int  # patches that were found in the image of another camera
    tried: int  # patches that were searched for
    searched: Range  # range that the measurement searches, metres

    @property
    def sentence(self) -> str:
        """The range of elevations as a sentence for the user."""
        ends, searched = (
            f"{100 * low:+.3g} to {100 * high:+.3g} cm" for low, high in (self.z, self.searched)
        )
        if not self.tried:
            return (
                f"elevation: the images are too small to find its range; searched {searched}; where water "
                "goes further state z_range"
            )
        if not self.found:
            ends = "not found"
        return (
            f"elevation: {ends} ({self.found} of {self.tried} patches found in another camera's image), "
            f"searched {searched}"
        )


def first_heights(read: Read, geometry: GridGeometry, frames: Sequence[int]) -> FirstHeights:
    """Find the range of elevations in some frames, by a search for large patches in rectified images.
    A patch is searched for in another camera's image; z follows from its displacement. An elevation counts if
    another patch has a similar one. `read(camera, frame)` gives an image or None."""
    kept: list[NDArray[np.float64]] = [np.zeros(0)]
    tried = 0
    agreement = max(0.25 * (geometry.z_range[1] - geometry.z_range[0]), 12 * geometry.pixel)
    for frame in frames:
        images = {name: read(name, frame) for name in geometry.surface_cameras}
        flat = {
            name: rectify(np.asarray(image), *geometry.views[name].maps)
            for name, image in images.items()
            if image is not None
        }
        for a, b in geometry.pairs:
            if a in flat and b in flat:
                moved = shifts(flat[a], flat[b], _reach((a, b), geometry))
                tried += len(moved)
                z = _heights(moved[np.isfinite(moved[:, 0])], (a, b), geometry)
                kept.append(z[(np.abs(z[:, None] - z) < agreement).sum(axis=0) > 1])
    found = np.concatenate(kept)
    ends = (float(found.min()) + 0.0, float(found.max()) + 0.0) if len(found) else (0.0, 0.0)  # no -0
    return FirstHeights(ends, len(found), tried, geometry.z_range)


def _reach(pair: tuple[str, str], geometry: GridGeometry) -> tuple[int, int]:
    """Return the largest displacement along x and y, rectified px, that the coarse search must cover."""
    x, y = np.meshgrid(geometry.lattice.x[[0, -1]], geometry.lattice.y[[0, -1]])
    one, other = (np.array(geometry.rig[name].sight_line(x, y)) for name in pair)
    height = SEARCH_FACTOR * max(abs(z) for z in geometry.z_range) / geometry.pixel
    along_x, along_y = height * np.abs(other - one).max(axis=(1, 2)) + 2 * MAX_EPIPOLAR_PX
    return int(along_x), int(along_y)


def _heights(
    moved: NDArray[np.float64], pair: tuple[str, str], geometry: GridGeometry
) -> NDArray[np.float64]:
    """Return z (n,), metres, of patches from their displacements (`shifts`) between the images of a pair.
    Patches with a large epipolar error (a displacement that no elevation explains) are left out."""
    dx, dy, x, y = moved.T
    dx, dy = geometry.pixel * dx, geometry.pixel * dy
    x, y = (origin + geometry.pixel * at for origin, at in zip(geometry.origin, (x, y)))
    Ax, Ay = geometry.rig[pair[0]].sight_line(x, y)
    Bx, By = geometry.rig[pair[1]].sight_line(x + dx, y + dy)
    px, py = Bx - Ax, By - Ay
    square = px * px + py * py
    with np.errstate(invalid="ignore", divide="ignore"):
        z = -(px * dx + py * dy) / square
        across = (py * dx - px * dy) / np.sqrt(square)
    out: NDArray[np.float64] = z[np.isfinite(z) & (np.abs(across) < MAX_EPIPOLAR_PX * geometry.pixel)]
    return out


def high_enough(settings: Settings, found: FirstHeights) -> tuple[Settings, FirstHeights]:
    """Return a tuple: settings and `found`, both with a wider range of z if heights fill over 0.6 of it."""
    low, high = found.searched
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if not found.found or all(abs(z - middle) < MAX_FILLED_RANGE * half for z in found.z):
        return settings, found
    margin = 0.5 * max(found.z[1] - found.z[0], half)
    wide = (round(found.z[0] - margin, 4), round(found.z[1] + margin, 4))
    return replace(settings, z_range=wide), replace(found, searched=wide)


def search_widened(pairs: Iterable[tuple[Images, Images]], geometry: GridGeometry) -> GridGeometry:
    """Return the geometry with search ranges that suit some frames; the same object if they suffice.
    `pairs` are the first and second images, by camera, of sample steps; the first SEARCHED_STEPS are used.
    Ranges that the user has set do not change."""
    steps = list(islice(pairs, SEARCHED_STEPS))

    def read(name: str, frame: int) -> NDArray[Any] | None:
        image = steps[frame // 2][frame % 2].get(name)
        if image is None or not usable(image, geometry.rig[name].size):
            return None
        return np.asarray(ready(image, geometry.sights[name].binning))

    first_frames = [2 * k for k in range(len(steps))]
    settings, usual = geometry.settings, Settings().piv
    if (settings.piv.search_x, settings.piv.search_y) == (usual.search_x, usual.search_y):
        settings = wide_enough(settings, first_guess(read, geometry.velocity_cameras, first_frames))
    if settings.z_range is None:
        settings, _ = high_enough(settings, first_heights(read, geometry, first_frames))
    if settings == geometry.settings:
        return geometry
    return GridGeometry(geometry.rig, geometry.grid, settings, geometry.covered)


def at_border(z: NDArray[Any], searched: tuple[float, float]) -> bool:
    """Return whether over 1 % of the elevations z lie outside the search range or within 3 % of its ends.
    `searched` is the search range (lowest, highest), in the unit of z; the 3 % are of its width."""
    known = z[np.isfinite(z)]
    if not known.size:
        return False
    spare = BORDER_FRACTION * (searched[1] - searched[0])
    outside = (known < searched[0] + spare) | (known > searched[1] - spare)
    return bool(outside.mean() > MIN_FRACTION_AT_BORDER)
