"""What reading other programs' calibrations has in common."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.lens import Array
from wavefield.rig.rotation import rotation_about

Size = tuple[int, int]
LENGTHS = {
    "m": 1.0,
    "meter": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "um": 1e-6,
    "km": 1000.0,
    "inch": 0.0254,
}


@dataclass(frozen=True)
class Stated:
    """What the user says of a file that the file does not."""

    sizes: Mapping[str, Size] | None = None  # (width, height): Image size per camera, px
    # Names for the cameras, in the file's order; cam1, cam2, ... if left out
    names: Sequence[str] | None = None
    unit: str = "m"  # Unit of length, or a number of metres

    @property
    def length(self) -> float:
        """The unit of length, metres."""
        if self.unit in LENGTHS:
            return LENGTHS[self.unit]
        try:
            return float(self.unit)
        except ValueError:
            raise RigError(
                f"{self.unit!r} is no unit of length; use one of {', '.join(LENGTHS)}, or a number of metres"
            ) from None

    def size(self, name: str, program: str, found: tuple[float, float] | None = None) -> Size:
        """Image size of a camera: as stated, or as found in the file."""
        size = (self.sizes or {}).get(name) or found
        if size is None:
            raise RigError(
                f"{program} does not store the image size: state it for {name!r} (`sizes`, width and height)"
            )
        return int(size[0]), int(size[1])

    def named(self, count: int, own: Sequence[str] | None = None) -> list[str]:
        """Names of the cameras: as stated, or the file's own."""
        if self.names is None:
            return list(own or (f"cam{n + 1}" for n in range(count)))
        if len(self.names) != count:
            raise RigError(f"it holds {count} cameras, but {len(self.names)} names were given")
        return list(self.names)


def rotation_near(matrix: Array) -> Array:
    """Nearest rotation: files round to a few digits."""
    U, _, V = np.linalg.svd(matrix)
    nearest: Array = U @ V
    if not np.abs(nearest - matrix).max() < 1e-3 or np.linalg.det(nearest) < 0:
        raise RigError("its rotation matrix is none")
    return nearest


def turned_about_axes(alpha: float, beta: float, gamma: float) -> Array:
    """R = Rz(gamma) Ry(beta) Rx(alpha), radians: what fits the matches of VIC-3D and the marks of DaVis."""
    about_x, about_y, about_z = (rotation_about(a * e) for a, e in zip((alpha, beta, gamma), np.eye(3)))
    turn: Array = about_z @ about_y @ about_x
    return turn


def numbers_of(parent: ET.Element, tag: str, count: int | None = None) -> list[float]:
    """Numbers of an element: all, or so many; a `RigError` where it has others."""
    element = parent.find(tag)
    if element is None or element.text is None:
        raise RigError(f"<{tag}> is missing")
    values = [float(v) for v in element.text.split()]
    if count is not None and len(values) != count:
        raise RigError(f"<{tag}> holds {len(values)} numbers instead of {count}")
    return values


def refuse_terms(camera: Camera, program: str, *known: str) -> None:
    """Refuse a camera with terms that another program does not know."""
    extra = [
        term
        for term in ("k1", "k2", "p1", "p2", "k3", "tau_x", "tau_y", "skew")
        if term not in known and getattr(camera, term) != 0.0
    ]
    if extra:
        raise RigError(
            f"{program} does not know {', '.join(extra)}: calibrate again with a model of "
            f"fx, fy, cx, cy{', ' if known else ''}{', '.join(known)}"
        )
