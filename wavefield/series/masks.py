"""Masks: outlines and images named in the experiment file, and the pixels and nodes inside them."""

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import Field, model_validator

from wavefield.config_files import ConfigSection
from wavefield.errors import ExperimentError, FrameError
from wavefield.rig import Camera, Rig
from wavefield.series.frames import CameraMask, FrameSeries, Outline, covered_pixels
from wavefield.series.readers import FrameEntry

WATER = "water"  # key of masks on the water; other keys are cameras
POINTS_PER_SIDE = 16  # points per side of a polygon on the water, which lens distortion bends


class MaskSection(ConfigSection):
    """One masked area: a polygon or an image."""

    polygon: list[tuple[float, float]] | None = Field(
        default=None,
        min_length=3,
        examples=["[[100, 80], [220, 80], [160, 200]]"],
        description="corners: column and row in a camera's image, px; x and y on the water, m",
    )
    image: str | None = Field(
        default=None, examples=['"masks/cam1.png"'], description="image whose pixels are masked unless black"
    )

    @model_validator(mode="after")
    def _one(self) -> "MaskSection":
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give a polygon or an image, not {' and '.join(given) or 'none'}")
        return self


def normalized(masks: object, cameras: Collection[str]) -> object:
    """Return the block ``mask`` of an experiment file with a list of mappings for each camera and ``water``.
    A file name becomes ``{"image": name}``. ValueError if a key is neither one of `cameras` nor ``water``."""
    if not isinstance(masks, Mapping):
        return masks
    out: dict[str, list[object]] = {}
    for name, shapes in masks.items():
        if name not in (*cameras, WATER):
            raise ValueError(f"mask names {name!r}, but there are {', '.join((*cameras, WATER))}")
        several = shapes if isinstance(shapes, list) else [shapes]
        out[name] = [{"image": shape} if isinstance(shape, str) else shape for shape in several]
    return out


def footprints(masks: Mapping[str, Sequence[MaskSection]]) -> tuple[Outline, ...]:
    """Return the outline of each mask on the water: the corners (x, y), m, of its polygon."""
    return tuple(tuple(shape.polygon) for shape in masks.get(WATER, ()) if shape.polygon is not None)


def covered_series(
    masks: Mapping[str, Sequence[MaskSection]],
    series: Mapping[str, FrameSeries],
    rig: Rig,
    folder: Path,
) -> dict[str, FrameSeries]:
    """Return the frames of each camera, with its own masks and the masks on the water as it sees them.
    `masks` is the block ``mask`` of the experiment file; images are in `folder`. ExperimentError if a mask
    image is bad, or if masks cover a whole image."""
    out = {}
    for name, frames in series.items():
        own, on_water = masks.get(name, ()), masks.get(WATER, ())
        drawn = [tuple(shape.polygon) for shape in own if shape.polygon]
        projected = [outline_in_image(shape, rig[name]) for shape in on_water]
        mask = CameraMask(
            frames.shape,
            (*drawn, *(outline for outline in projected if outline)),
            tuple(FrameEntry("file", str(folder / shape.image)) for shape in own if shape.image),
        )
        if mask == CameraMask(frames.shape):
            out[name] = frames
            continue
        try:
            everywhere = covered_pixels(mask).all()
        except FrameError as error:
            raise ExperimentError(f"mask of {name}: {error}") from None
        if everywhere:
            raise ExperimentError(
                f"mask of {name}: it covers the whole image; all that is not black is masked: invert it?"
            )
        out[name] = replace(frames, mask=mask)
    return out


def outline_in_image(shape: MaskSection, camera: Camera) -> Outline:
    """Return the outline of a mask on the still water, as (column, row) in px of a camera's image.
    It is empty if the mask is out of the camera's view, or partly behind the camera."""
    p = np.array(shape.polygon)
    t = np.arange(POINTS_PER_SIDE)[:, None] / POINTS_PER_SIDE
    edge = np.concatenate([a + t * (b - a) for a, b in zip(p, np.roll(p, -1, axis=0))])
    corners = np.stack(camera.project(edge[:, 0], edge[:, 1], 0.0), axis=-1)
    if not np.isfinite(corners).all():
        return ()
    w, h = camera.size
    if (corners.max(axis=0) < 0).any() or (corners.min(axis=0) > (w - 1, h - 1)).any():
        return ()
    limit = np.iinfo(np.int16)  # OpenCV draws no further; there only the direction of a corner matters
    return tuple((float(x), float(y)) for x, y in np.clip(corners, limit.min, limit.max))


def as_data(masks: Mapping[str, Sequence[MaskSection]], folder: Path) -> dict[str, list[dict[str, object]]]:
    """Return the masks of each camera, and of ``water``, as plain data, to record them in a cube.
    For a mask image in `folder`, a checksum of the file is added as ``content``."""
    out: dict[str, list[dict[str, object]]] = {}
    for name, shapes in masks.items():
        out[name] = [shape.model_dump(exclude_none=True, mode="json") for shape in shapes]
        for shape, data in zip(shapes, out[name]):
            if shape.image:
                content = (folder / shape.image).read_bytes()
                data["content"] = hashlib.sha256(content).hexdigest()[:16]
    return out
