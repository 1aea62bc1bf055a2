"""All that the frames of one instant give on their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from numpy.typing import NDArray

from wavefield import matching
from wavefield.measurement import pair_surface
from wavefield.measurement.covered import Covered
from wavefield.measurement.elevation import Surface, surface
from wavefield.measurement.field_model import Model
from wavefield.measurement.frame import IN_TIME, ready, sharpened, usable
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.masked import Masks, covered_in

Frames = Mapping[str, NDArray[Any] | None]


@dataclass(frozen=True)
class Images:
    """The usable frames of one instant, ready for matching."""

    flat: Mapping[str, matching.PreparedImage]  # Rectified, for the surface; none of a light sheet
    raw: Mapping[str, matching.PreparedImage]  # For matching in time
    missing: frozenset[str]  # Cameras without a usable frame
    covered: Mapping[str, Covered]  # Masks


@dataclass(frozen=True)
class Instant:
    """The surface of one instant, and its images for matching in time."""

    surface: Surface | None  # Elevation at the nodes; None if it could not be measured
    images: Images
    frames: Frames  # The frames themselves, should a camera have to be left out
    masks: Masks
    _without: dict[str, Surface | None] = field(default_factory=dict)

    def without(self, camera: str, geometry: GridGeometry, model: Model) -> Surface | None:
        """Elevation at the nodes by the other cameras."""
        if camera not in self._without:
            rest = {name: image for name, image in self.frames.items() if name != camera}
            ready_frames = _ready_frames(rest, geometry, dict(model.record.beads), self.masks)
            flat = _rectified(ready_frames, geometry, self.images.covered)
            self._without[camera] = surface(flat, geometry, model.elevation)
        return self._without[camera]

    def without_images(self) -> Instant:
        """The same without images for matching in time, which take most of the memory."""
        return replace(self, images=replace(self.images, raw={}))


def _ready_frames(
    frames: Frames, geometry: GridGeometry, beads: Mapping[str, float], masks: Masks
) -> dict[str, NDArray[Any]]:
    """Usable frames with the floor removed, of even brightness, binned."""
    out: dict[str, NDArray[Any]] = {}
    for name in geometry.cameras:
        image = frames.get(name)
        if image is not None and usable(image, geometry.rig[name].size):
            out[name] = ready(image, geometry.sights[name].binning, beads[name], masks.get(name))
    return out


def _rectified(
    ready_frames: Mapping[str, NDArray[Any]], geometry: GridGeometry, covered: Mapping[str, Covered]
) -> dict[str, matching.PreparedImage]:
    """Images ready for matching between cameras; none of a light sheet."""
    if geometry.settings.sheet_thickness is not None:
        return {}
    return {
        name: pair_surface.prepare(
            ready_frames[name], name, geometry, covered[name].flat if name in covered else None
        )
        for name in geometry.surface_cameras
        if name in ready_frames
    }


def images_of(
    frames: Frames, geometry: GridGeometry, beads: Mapping[str, float], masks: Masks | None = None
) -> Images:
    """Make the frames of one instant ready for matching; with the widths of beads, raw px, and masks."""
    masks = masks or {}
    covered = covered_in(masks, geometry)
    ready_frames = _ready_frames(frames, geometry, beads, masks)
    flat = _rectified(ready_frames, geometry, covered)
    return _with_raw(flat, ready_frames, geometry, covered)


def _with_raw(
    flat: Mapping[str, matching.PreparedImage],
    ready_frames: Mapping[str, NDArray[Any]],
    geometry: GridGeometry,
    covered: Mapping[str, Covered],
) -> Images:
    """Rectified images with those for matching in time."""
    raw = {
        name: matching.prepare(
            sharpened(ready_frames[name], IN_TIME),
            geometry.settings.piv,
            covered[name].raw if name in covered else None,
        )
        for name in geometry.velocity_cameras
        if name in ready_frames
    }
    missing = frozenset(name for name in geometry.cameras if name not in ready_frames)
    return Images(flat, raw, missing, covered)


def measure_instant(
    frames: Frames, geometry: GridGeometry, model: Model, masks: Masks | None = None
) -> Instant:
    """Elevation and prepared images of one instant; masks are True where pixels do not count."""
    masks = masks or {}
    covered = covered_in(masks, geometry)
    ready_frames = _ready_frames(frames, geometry, dict(model.record.beads), masks)
    # the rectified images are dropped before those for matching in time are made: either takes 20 MB
    found = surface(_rectified(ready_frames, geometry, covered), geometry, model.elevation)
    return Instant(found, _with_raw({}, ready_frames, geometry, covered), frames, masks)
