"""Everything that the frames of one instant give on their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from numpy.typing import NDArray

from wavefield import matching
from wavefield.measurement import pair_surface as stereo
from wavefield.measurement.elevation import Surface, surface
from wavefield.measurement.frame import IN_TIME, ready, sharpened, usable
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.masked import Covered, Masks, covered_in
from wavefield.measurement.model import Model

Frames = Mapping[str, NDArray[Any] | None]


@dataclass(frozen=True)
class Images:
    """The usable frames of one instant, ready for matching."""

    # Rectified images, for the surface (none of a light sheet); raw ones, for matching in time
    flat: Mapping[str, matching.PreparedImage]
    raw: Mapping[str, matching.PreparedImage]
    missing: frozenset[str]  # Cameras without a usable frame
    covered: Mapping[str, Covered] = field(default_factory=dict)  # What is masked


@dataclass(frozen=True)
class Instant:
    """What is kept of one instant."""

    surface: Surface | None  # Elevation at the nodes; None if it could not be measured
    images: Mapping[str, matching.PreparedImage]  # Raw images ready for matching in time
    missing: frozenset[str]  # Cameras without a usable frame
    frames: Frames  # The frames themselves, should a camera have to be left out
    masks: Masks  # What is masked in them
    covered: Mapping[str, Covered] = field(default_factory=dict)  # The same, ready for matching
    _others: dict[str, Surface | None] = field(default_factory=dict)

    def without(self, camera: str, geometry: GridGeometry, model: Model) -> Surface | None:
        """Elevation at the nodes by the other cameras."""
        if camera not in self._others:
            rest = {name: image for name, image in self.frames.items() if name != camera}
            good = _evened(rest, geometry, dict(model.record.beads), self.masks)
            self._others[camera] = surface(_rectified(good, geometry, self.covered), geometry, model)
        return self._others[camera]

    def followed(self) -> Instant:
        """The same without the images, once they are matched in time: they hold most of the memory."""
        return replace(self, images={})


def _evened(
    frames: Frames, geometry: GridGeometry, beads: Mapping[str, float], masks: Masks
) -> dict[str, NDArray[Any]]:
    """Usable frames as they are matched, binned."""
    good: dict[str, NDArray[Any]] = {}
    for name in geometry.cameras:
        image = frames.get(name)
        if image is not None and usable(image, geometry.rig[name].size):
            good[name] = ready(image, geometry.sights[name].binning, beads[name], masks.get(name))
    return good


def _rectified(
    good: Mapping[str, NDArray[Any]], geometry: GridGeometry, covered: Mapping[str, Covered]
) -> dict[str, matching.PreparedImage]:
    """Images ready for matching between cameras; none of a light sheet."""
    if geometry.settings.sheet_thickness is not None:
        return {}
    mask = {n: one.flat for n, one in covered.items()}
    return {
        n: stereo.prepare(good[n], n, geometry, mask.get(n)) for n in geometry.surface_cameras if n in good
    }


def images_of(
    frames: Frames,
    geometry: GridGeometry,
    beads: Mapping[str, float],
    masks: Masks | None = None,
) -> Images:
    """Make the frames of one instant ready for matching.

    With masks (row, column).
    """
    masks = masks or {}
    covered = covered_in(masks, geometry)
    good = _evened(frames, geometry, beads, masks)
    flat = _rectified(good, geometry, covered)
    raw_of = {n: one.raw for n, one in covered.items()}
    sharp = {n: sharpened(good[n], IN_TIME) for n in geometry.velocity_cameras if n in good}
    raw = {n: matching.prepare(image, geometry.settings.piv, raw_of.get(n)) for n, image in sharp.items()}
    return Images(flat, raw, frozenset(n for n in geometry.cameras if n not in good), covered)


def measure_instant(
    frames: Frames, geometry: GridGeometry, model: Model, masks: Masks | None = None
) -> Instant:
    """Everything that the frames of one instant give on their own.

    With masks (row, column).
    """
    images = images_of(frames, geometry, dict(model.record.beads), masks)
    found = surface(images.flat, geometry, model)
    return Instant(found, images.raw, images.missing, frames, masks or {}, images.covered)
