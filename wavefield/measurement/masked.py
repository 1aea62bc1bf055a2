"""Masks of images, prepared for matching and read at the nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.matching.prepared import Mask
from wavefield.measurement.covered import Covered, Pixels
from wavefield.measurement.geometry import GridGeometry

Masks = Mapping[str, Pixels | None]


def covered_in(masks: Masks, geometry: GridGeometry) -> dict[str, Covered]:
    """Masks of one instant, ready for matching; one that stays the same is prepared once."""
    out = {}
    for name in geometry.cameras:
        pixels = masks.get(name)
        if pixels is None:
            continue
        last = geometry.prepared_masks.get(name)
        if last is None or last[0] is not pixels:
            last = pixels, _ready(pixels, name, geometry)
            geometry.prepared_masks[name] = last
        out[name] = last[1]
    return out


def _ready(pixels: Pixels, name: str, geometry: GridGeometry) -> Covered:
    w, h = geometry.sights[name].camera.size
    count = geometry.sights[name].binning
    good = np.where(pixels[: h * count, : w * count], np.uint8(0), np.uint8(255))
    good = cv2.resize(good, (w, h), interpolation=cv2.INTER_AREA) if count > 1 else good
    flat = None
    if name in geometry.views:
        X, Y = (np.float32(0.5) * place for place in geometry.views[name].maps)
        seen = cv2.remap(good, X, Y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        flat = Mask.of(geometry.views[name].visible & (seen > 250), geometry.settings.stereo)
    return Covered(Mask.of(good > 250, geometry.settings.piv), flat)


MIN_BARE_FRACTION = 0.1


def bare_of_camera(covered: Sequence[Covered | None]) -> float:
    """Fraction of a camera's blocks that are masked in none of some images."""
    levels = [one.raw.levels[0] > 0 for one in covered if one is not None]
    return max(float(np.logical_and.reduce(levels).mean()), MIN_BARE_FRACTION) if levels else 1.0


def bare_of_pairs(covered: Mapping[str, Covered], geometry: GridGeometry) -> float:
    """Fraction of the common views of pairs that is masked in neither camera, mean over the pairs."""

    def level(name: str, mask: Mask | None) -> Pixels:
        return (geometry.views[name].mask if mask is None else mask).levels[0] > 0

    flat = {name: one.flat for name, one in covered.items() if one.flat is not None}
    if not flat:
        return 1.0
    bare, seen = 0.0, 0.0
    for a, b in geometry.pairs:
        bare += float((level(a, flat.get(a)) & level(b, flat.get(b))).sum())
        seen += float((level(a, None) & level(b, None)).sum())
    return max(bare / max(seen, 1.0), MIN_BARE_FRACTION)


def masked_nodes(
    covered: tuple[Mapping[str, Covered], Mapping[str, Covered]],
    missing: frozenset[str],
    z: NDArray[Any],
    geometry: GridGeometry,
) -> Pixels:
    """Nodes (ny, nx) masked by an outline on the water, or for too many cameras, on the surface z, metres.
    True where no pair of the surface's cameras, or fewer than two of the velocity's, are left.
    """
    hidden = {}
    for name in {*covered[0], *covered[1]}:
        X, Y = geometry.sights[name].position(z)
        hidden[name] = np.any([one[name].at(X, Y) for one in covered if name in one], axis=0)
    nowhere = np.zeros(z.shape, bool)
    present = [name for name in geometry.cameras if name not in missing]
    pairs = geometry.pairs_for([n for n in geometry.surface_cameras if n in present])
    no_pair = np.all([hidden.get(a, nowhere) | hidden.get(b, nowhere) for a, b in pairs], axis=0)
    velocity = [name for name in geometry.velocity_cameras if name in present]
    seeing = np.sum([~hidden.get(name, nowhere) for name in velocity], axis=0)
    return np.asarray(geometry.covered_nodes | no_pair | (seeing < 2))
