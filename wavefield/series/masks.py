"""What does not count as water: outlines and images in the experiment file, and what they cover."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from wavefield.config_files import ConfigSection
from wavefield.errors import ExperimentError, FrameError
from wavefield.rig import Camera, Rig
from wavefield.series.camera_mask import CameraMask, Outline
from wavefield.series.frames import FrameSeries
from wavefield.series.listing import number_frames
from wavefield.series.readers import FrameEntry

WATER = "water"  # the key of masks that lie on the water, not in one camera's image
_CORNERS = 64  # of a circle's outline
_SIDE_POINTS = 16  # along an edge on the water: it is no straight line in an image


class CylinderSection(ConfigSection):
    """An upright cylinder that pierces the surface, metres."""

    x: float = Field(examples=["0.2"])
    y: float = Field(examples=["-0.1"])
    radius: float = Field(gt=0, examples=["0.1"])
    top: float | None = Field(default=None, description="z of its top; as high as the cameras if left out")
    bottom: float | None = Field(
        default=None, description="z down to which it is seen; the lowest water searched if left out"
    )

    @model_validator(mode="after")
    def _upright(self) -> "CylinderSection":
        if self.top is not None and self.bottom is not None and self.top <= self.bottom:
            raise ValueError(f"its top ({self.top:g} m) must be above its bottom ({self.bottom:g} m)")
        return self


class MaskSection(ConfigSection):
    """One thing that covers the water; exactly one of these."""

    polygon: list[tuple[float, float]] | None = Field(
        default=None,
        examples=["[[100, 80], [220, 80], [160, 200]]"],
        description="corners: column and row in a camera's image, px; x and y on the water, m",
    )
    image: str | None = Field(
        default=None, examples=['"masks/cam1.png"'], description="what is not black in it is covered"
    )
    frames: str | None = Field(
        default=None,
        examples=['"masks/cam1/{frame:05d}.png"'],
        description="such an image for every frame, numbered as the camera's",
    )
    cylinder: CylinderSection | None = Field(
        default=None, examples=["{x: 0.2, y: -0.1, radius: 0.1}"], description="only on the water"
    )

    @field_validator("polygon")
    @classmethod
    def _simple(cls, corners: list[tuple[float, float]] | None) -> list[tuple[float, float]] | None:
        if corners is None:
            return None
        if len(corners) < 3:
            raise ValueError(f"a polygon needs three corners or more, not {len(corners)}")
        if (crossed := crossing(corners)) is not None:
            a, b = (number + 1 for number in crossed)
            raise ValueError(
                f"the sides that begin at corners {a} and {b} cross; list the corners in order around it"
            )
        return corners

    @model_validator(mode="after")
    def _one(self) -> "MaskSection":
        given = [
            name for name in ("polygon", "image", "frames", "cylinder") if getattr(self, name) is not None
        ]
        if len(given) != 1:
            raise ValueError(
                f"give one of polygon, image, frames, cylinder, not {' and '.join(given) or 'none'}"
            )
        return self


def crossing(corners: Sequence[tuple[float, float]]) -> tuple[int, int] | None:
    """Two sides of a polygon that cross.

    With corners (float, float); returns (int, int): Numbers of the corners at which the sides begin, from 0;
    None if it does not cross itself.

    Examples
    --------
    >>> crossing([(0, 0), (1, 1), (1, 0), (0, 1)])
    (0, 2)
    >>> crossing([(0, 0), (1, 0), (1, 1), (0, 1)])
    """
    p = np.asarray(corners, float)
    q = np.roll(p, -1, axis=0)

    def side(a: NDArray[Any], b: NDArray[Any], c: NDArray[Any]) -> float:
        return float(np.sign((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])))

    for i in range(len(p)):
        for j in range(i + 2, len(p)):
            if i == 0 and j == len(p) - 1:
                continue  # neighbours
            apart = side(p[i], q[i], p[j]) * side(p[i], q[i], q[j])
            if apart < 0 and side(p[j], q[j], p[i]) * side(p[j], q[j], q[i]) < 0:
                return i, j
    return None


def normalized(masks: Any, cameras: Iterable[str]) -> Any:
    """Write out the short forms of ``mask:`` and refuse what belongs to no camera."""
    if not isinstance(masks, Mapping):
        return masks
    out: dict[str, Any] = {}
    for name, shapes in masks.items():
        if name not in (*cameras, WATER):
            raise ValueError(f"mask names {name!r}, but there are {', '.join((*cameras, WATER))}")
        several = shapes if isinstance(shapes, list) else [shapes]
        out[name] = [_written_out(shape) if isinstance(shape, str) else shape for shape in several]
    return out


def _written_out(name: str) -> dict[str, str]:
    moves = "{frame" in name or any(c in Path(name).name for c in "*?[")
    return {"frames" if moves else "image": name}


def check(masks: Mapping[str, Sequence[MaskSection]]) -> None:
    """Refuse what makes no sense where it stands."""
    for name, shapes in masks.items():
        for shape in shapes:
            if name == WATER and (shape.image or shape.frames):
                raise ValueError(
                    "mask: an image belongs to a camera; on the water give a polygon or a cylinder"
                )
            if name != WATER and shape.cylinder:
                raise ValueError(f"mask: the cylinder stands under {name}; put it under `water`, in metres")


# -- what they cover -----------------------------------------------------------------------------------------


def footprints(masks: Mapping[str, Sequence[MaskSection]]) -> tuple[Outline, ...]:
    """Outlines on the water of what covers nodes, whatever the cameras see.

    Returns (x, y): Metres.
    """
    out: list[Outline] = []
    for shape in masks.get(WATER, ()):
        if shape.cylinder is not None:
            out.append(tuple(map(tuple, _circle(shape.cylinder).tolist())))
        elif shape.polygon is not None:
            out.append(tuple(shape.polygon))
    return tuple(out)


def covered_series(
    masks: Mapping[str, Sequence[MaskSection]],
    series: Mapping[str, FrameSeries],
    rig: Rig,
    folder: Path,
    reach: float,
) -> dict[str, FrameSeries]:
    """Frames that know what is covered in them."""
    out = {}
    for name, frames in series.items():
        own, below = masks.get(name, ()), masks.get(WATER, ())
        mask = CameraMask(
            frames.shape,
            tuple(_in_image(name, shape, frames.shape) for shape in own if shape.polygon)
            + tuple(o for shape in below if (o := _seen(shape, rig[name], reach))),
            tuple(_file(name, folder / shape.image) for shape in own if shape.image),
            _for_every_frame(name, [s.frames for s in own if s.frames], frames, folder),
        )
        if mask == CameraMask(frames.shape):
            out[name] = frames
            continue
        _check_size(name, mask)
        out[name] = replace(frames, mask=mask)
    return out


def _check_size(name: str, mask: CameraMask) -> None:
    try:
        covered = mask.covered(0)
    except FrameError as error:
        raise ExperimentError(f"mask of {name}: {error}") from None
    if covered.all():
        raise ExperimentError(
            f"mask of {name}: it covers the whole image; what is not black is covered, so perhaps invert it"
        )


def _file(name: str, path: Path) -> FrameEntry:
    if not path.is_file():
        raise ExperimentError(f"mask of {name}: there is no {path}; correct `mask`, or save the image there")
    return FrameEntry("file", str(path))


def _in_image(name: str, shape: MaskSection, size: tuple[int, int]) -> Outline:
    assert shape.polygon is not None
    (left, top), (right, bottom) = np.min(shape.polygon, axis=0), np.max(shape.polygon, axis=0)
    if right < 0 or bottom < 0 or left > size[1] - 1 or top > size[0] - 1:
        raise ExperimentError(
            f"mask of {name}: the polygon from column {left:g}, row {top:g} to column {right:g}, row "
            f"{bottom:g} lies outside the image of {size[1]} x {size[0]} px; give columns and rows in it"
        )
    return tuple(shape.polygon)


def _for_every_frame(
    name: str, patterns: Sequence[str], series: FrameSeries, folder: Path
) -> tuple[FrameEntry, ...]:
    if not patterns:
        return ()
    if len(patterns) > 1:
        raise ExperimentError(f"mask of {name}: `frames` is there twice; draw both into one image per frame")
    numbered = number_frames(patterns[0], folder, f"the mask of {name}")
    absent = [
        number
        for number, entry in enumerate(series.entries, series.first)
        if entry is not None and number not in numbered
    ]
    if absent:
        raise ExperimentError(
            f"mask of {name}: {folder / patterns[0]} has no image for frame {absent[0]}"
            + (f" and {len(absent) - 1} others" if len(absent) > 1 else "")
            + "; every frame needs one (black where nothing is covered), or set `frames: first, last`"
        )
    some = next(iter(numbered.values()))  # where there is no frame, any will do
    return tuple(numbered.get(series.first + k, some) for k in range(len(series)))


def _seen(shape: MaskSection, camera: Camera, reach: float) -> Outline:
    """Outline in an image of what lies on the water; empty where the camera does not see it."""
    if shape.cylinder is not None:
        corners = _silhouette(shape.cylinder, camera, reach)
    else:
        assert shape.polygon is not None
        p = np.array(shape.polygon)
        t = np.arange(_SIDE_POINTS)[:, None] / _SIDE_POINTS
        edge = np.concatenate([a + t * (b - a) for a, b in zip(p, np.roll(p, -1, axis=0))])
        corners = np.stack(camera.project(edge[:, 0], edge[:, 1], 0.0), axis=-1)
    if not np.isfinite(corners).all():
        return ()
    w, h = camera.size
    if (corners.max(axis=0) < 0).any() or (corners.min(axis=0) > (w - 1, h - 1)).any():
        return ()
    limit = 16.0 * max(w, h)  # far outside: only its direction matters
    return tuple((float(x), float(y)) for x, y in np.clip(corners, -limit, limit))


def _circle(cylinder: CylinderSection) -> NDArray[np.float64]:
    angle = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    radius = cylinder.radius / np.cos(np.pi / _CORNERS)  # around the circle
    return np.stack([cylinder.x + radius * np.cos(angle), cylinder.y + radius * np.sin(angle)], axis=-1)


def _silhouette(cylinder: CylinderSection, camera: Camera, reach: float) -> NDArray[np.float64]:
    ring = _circle(cylinder)
    bottom = -reach if cylinder.bottom is None else cylinder.bottom
    top = 0.9 * float(camera.centre[2]) if cylinder.top is None else cylinder.top
    points = [
        np.stack(camera.project(ring[:, 0], ring[:, 1], z), axis=-1) for z in np.linspace(bottom, top, 5)
    ]
    seen = np.concatenate(points)
    seen = seen[np.isfinite(seen).all(axis=1)]
    if not len(seen):
        return np.full((1, 2), np.nan)
    return np.asarray(cv2.convexHull(seen.astype(np.float32))[:, 0], np.float64)


def as_data(masks: Mapping[str, Sequence[MaskSection]], folder: Path) -> dict[str, Any]:
    """Masks as plain data for a recipe: what a cube's values follow from."""
    out: dict[str, Any] = {}
    for name, shapes in masks.items():
        out[name] = [shape.model_dump(exclude_none=True, mode="json") for shape in shapes]
        for data in out[name]:
            if "image" in data:
                content = (folder / data["image"]).read_bytes()
                data["content"] = hashlib.sha256(content).hexdigest()[:16]
    return out
