"""How high the water stands and how far it rises: a coarse look over the record, before it is measured.

The matching between cameras searches the parallax of a range of elevations. Here that range is found from
the images themselves, once per run, and written into the recipe.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.first_guess import shifts
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.measurement_settings import Settings
from wavefield.measurement.rectify import rectify

_COARSE = 2  # px averaged along each side: what the cameras see differently of a bead matters less
_PIECE = 48  # px of these: side of the pieces that are looked for
_ACROSS = 5.0  # px of these that a piece may lie beside where its sight lines meet
_FAR = 5.0  # times the usual range of elevations: how far pieces are looked for
_ROOM = 0.6  # of the usual range: water that goes further in a few looks goes beyond it in a long record
_MARGIN = 0.3  # of the span that was found, added on either side; and half of the usual range

Read = Callable[[str, int], NDArray[Any] | None]


@dataclass(frozen=True)
class FirstHeights:
    """Range of the elevations over the record."""

    z: tuple[float, float]  # (float, float): Lowest and highest elevation that was found, metres
    found: int  # Pieces of images that were found in the other camera's, and all that were looked for
    tried: int
    searched: tuple[float, float]  # (float, float): Range that the run searches, metres

    @property
    def sentence(self) -> str:
        """All this for a person."""
        low, high = (100 * z for z in self.searched)
        if not self.tried:
            return (
                f"elevation: the images are too small for a look at its range; searched {low:+.1f} to "
                f"{high:+.1f} cm; where water goes further state z_range"
            )
        if not self.found:
            return (
                f"elevation: none of {self.tried} pieces of images is found in another camera's; "
                f"searched {low:+.1f} to {high:+.1f} cm"
            )
        return (
            f"elevation: {100 * self.z[0]:+.1f} to {100 * self.z[1]:+.1f} cm ({self.found} of {self.tried} "
            f"pieces found in another camera's image), searched {low:+.1f} to {high:+.1f} cm"
        )


def first_heights(read: Read, geometry: GridGeometry, frames: Sequence[int]) -> FirstHeights:
    """Look at some instants of a record.

    Pieces of one camera's image rectified to z = 0 are looked for in another's; their parallax is that of
    `match_pair`.
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
                moved = shifts(flat[a], flat[b], _PIECE, _reach((a, b), geometry))
                tried += len(moved)
                z = _heights(moved[np.isfinite(moved[:, 0])], (a, b), geometry)
                apart = np.abs(z[:, None] - z) < _near(geometry)
                kept.append(z[apart.sum(axis=0) > 1])
    found = np.concatenate(kept) if kept else np.zeros(0)
    ends = (float(found.min()), float(found.max())) if len(found) else (0.0, 0.0)
    return FirstHeights(ends, len(found), tried, geometry.z_range)


def _reach(pair: tuple[str, str], geometry: GridGeometry) -> tuple[int, int]:
    """Largest parallax along x and along y of elevations that are looked for, coarse px."""
    x, y = np.meshgrid(geometry.lattice.x[[0, -1]], geometry.lattice.y[[0, -1]])
    (Ax, Ay), (Bx, By) = (geometry.rig[name].sight_line(x, y) for name in pair)
    height = _FAR * max(abs(z) for z in geometry.z_range) / (_COARSE * geometry.pixel)
    along = (int(height * np.abs(b - a).max() + 2 * _ACROSS) for a, b in ((Ax, Bx), (Ay, By)))
    return next(along), next(along)


def _near(geometry: GridGeometry) -> float:
    """Elevations closer than this bear each other out, metres."""
    return max(0.25 * (geometry.z_range[1] - geometry.z_range[0]), 12 * geometry.pixel)


def _coarse(image: NDArray[Any]) -> NDArray[np.float32]:
    small = cv2.resize(
        image.astype(np.float32), None, fx=1 / _COARSE, fy=1 / _COARSE, interpolation=cv2.INTER_AREA
    )
    return np.asarray(small, np.float32)


def _heights(
    moved: NDArray[np.float64], pair: tuple[str, str], geometry: GridGeometry
) -> NDArray[np.float64]:
    """Elevations of pieces (n, 5) as from `shifts`, metres; those whose sight lines miss are left out."""
    step = _COARSE * geometry.pixel
    half = 0.5 * (_COARSE - 1) * geometry.pixel
    x, y = (origin + half + step * at for origin, at in zip(geometry.plane.origin, moved[:, 3:].T))
    dx, dy = step * moved[:, 0], step * moved[:, 1]
    Ax, Ay = geometry.rig[pair[0]].sight_line(x, y)
    Bx, By = geometry.rig[pair[1]].sight_line(x + dx, y + dy)
    px, py = Bx - Ax, By - Ay
    square = px * px + py * py
    with np.errstate(invalid="ignore", divide="ignore"):
        z = -(px * dx + py * dy) / square
        across = (py * dx - px * dy) / np.sqrt(square)
    out: NDArray[np.float64] = z[np.isfinite(z) & (np.abs(across) < _ACROSS * step)]
    return out


def high_enough(settings: Settings, found: FirstHeights) -> tuple[Settings, FirstHeights]:
    """Settings that search as high and as low as the water goes."""
    low, high = found.searched
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if not found.found or all(abs(z - middle) < _ROOM * half for z in found.z):
        return settings, found
    margin = max(_MARGIN * (found.z[1] - found.z[0]), 0.5 * half)
    wide = (round(found.z[0] - margin, 4), round(found.z[1] + margin, 4))
    return replace(settings, z_range=wide), replace(found, searched=wide)
