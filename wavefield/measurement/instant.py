"""Everything that the frames of one instant give on their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from wavefield import matching
from wavefield.measurement import surface as stereo
from wavefield.measurement.covered import Covered, Masks, covered_in
from wavefield.measurement.elevation import Surface, surface
from wavefield.measurement.frame import IN_TIME, ready, sharpened, usable
from wavefield.measurement.plan import Plan


@dataclass(frozen=True)
class Images:
    """The usable frames of one instant, ready for matching.

    Parameters
    ----------
    flat, raw : mapping of str to Prepared
        Rectified images, for the surface (none of a light sheet); raw ones, for matching in time.
    missing : frozenset of str
        Cameras without a usable frame.
    covered : mapping of str to Covered
        What is masked.
    """

    flat: Mapping[str, matching.Prepared]
    raw: Mapping[str, matching.Prepared]
    missing: frozenset[str]
    covered: Mapping[str, Covered] = field(default_factory=dict)


@dataclass(frozen=True)
class Instant:
    """What is kept of one instant.

    Parameters
    ----------
    surface : Surface or None
        Elevation at the nodes; None if it could not be measured.
    images : mapping of str to Prepared
        Raw images ready for matching in time.
    missing : frozenset of str
        Cameras without a usable frame.
    flat : mapping of str to Prepared
        Rectified images, should a camera have to be left out.
    covered : mapping of str to Covered
        What is masked.
    """

    surface: Surface | None
    images: Mapping[str, matching.Prepared]
    missing: frozenset[str]
    flat: Mapping[str, matching.Prepared]
    covered: Mapping[str, Covered] = field(default_factory=dict)
    _others: dict[str, Surface | None] = field(default_factory=dict)

    def without(self, camera: str, plan: Plan) -> Surface | None:
        """Elevation at the nodes by the other cameras.

        Parameters
        ----------
        camera : str
            The one left out.
        plan : Plan
            As for `look`.

        Returns
        -------
        Surface or None
        """
        if camera not in self._others:
            rest = {name: image for name, image in self.flat.items() if name != camera}
            self._others[camera] = surface(rest, plan)
        return self._others[camera]


def images_of(
    frames: Mapping[str, NDArray[Any] | None],
    plan: Plan,
    beads: Mapping[str, float],
    masks: Masks | None = None,
) -> Images:
    """Make the frames of one instant ready for matching.

    Parameters
    ----------
    frames : mapping of str to ndarray or None
        One frame per camera.
    plan : Plan
        Everything computed beforehand.
    beads : mapping of str to float
        Width of every camera's beads, raw px.
    masks : mapping of str to ndarray of bool, (row, column), or None
        True where pixels of a camera's image do not count.

    Returns
    -------
    Images
    """
    good: dict[str, NDArray[Any]] = {}
    masks = masks or {}
    covered = covered_in(masks, plan)
    for name in plan.cameras:
        image = frames.get(name)
        if image is not None and usable(image, plan.rig[name].size):
            good[name] = ready(image, plan.binning[name], beads[name], masks.get(name))
    flat_of = {n: one.flat for n, one in covered.items()}
    raw_of = {n: one.raw for n, one in covered.items()}
    matched = plan.surface_cameras if plan.settings.sheet_thickness is None else ()
    flat = {n: stereo.prepare(good[n], n, plan, flat_of.get(n)) for n in matched if n in good}
    sharp = {n: sharpened(good[n], IN_TIME) for n in plan.velocity_cameras if n in good}
    raw = {n: matching.prepare(image, plan.settings.piv, raw_of.get(n)) for n, image in sharp.items()}
    return Images(flat, raw, frozenset(n for n in plan.cameras if n not in good), covered)


def look(frames: Mapping[str, NDArray[Any] | None], plan: Plan, masks: Masks | None = None) -> Instant:
    """Everything that the frames of one instant give on their own.

    Parameters
    ----------
    frames : mapping of str to ndarray or None
        One frame per camera.
    plan : Plan
        Everything computed beforehand, its record learned.
    masks : mapping of str to ndarray of bool, (row, column), or None
        True where pixels of a camera's image do not count.

    Returns
    -------
    Instant
    """
    assert plan.record is not None
    images = images_of(frames, plan, dict(plan.record.beads), masks)
    return Instant(surface(images.flat, plan), images.raw, images.missing, images.flat, images.covered)
