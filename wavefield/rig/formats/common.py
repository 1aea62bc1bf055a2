"""Parts that readers and writers of other programs' calibrations share."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wavefield.errors import RigError
from wavefield.rig.camera import Camera
from wavefield.rig.lens import Array, rotation_about
from wavefield.rig.rig import Rig

Size = tuple[int, int]
LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "um": 1e-6, "inch": 0.0254}
_ABBREVIATED = {"meter": "m", "centimeter": "cm", "millimeter": "mm", "in": "inch", "inche": "inch"}
MAX_DISTANCE = 20.0  # m between cameras; if a file states no unit and they are farther apart, it is not m

Pose = tuple[Array, Array]  # rotation (3, 3) and translation (3,), metres, from the world to the camera
FIRST_CAMERA: Pose = np.eye(3), np.zeros(3)  # the world is the first camera's frame


@dataclass(frozen=True)
class ImportOptions:
    """Details that the user gives because a file may lack them: image sizes, camera names, unit of length."""

    sizes: Mapping[str, Size] | None = None  # Image (width, height) by camera, px
    names: Sequence[str] | None = None  # Names of the cameras, in the file's order
    unit: str | None = None  # Unit of length, or its size in metres; None: the file's or the program's unit

    def length(self, usual: str | None, stated: str = "") -> tuple[float, str]:
        """Return the size of the unit of length in metres, and its name; RigError for an unknown unit.
        The unit given by the user comes first, then the file's (`stated`), then the program's usual unit.
        If there is none of these, it is the metre, with an empty name."""
        unit = self.unit or stated.strip() or usual
        if unit is None:
            return 1.0, ""
        plain = unit.lower().replace("metre", "meter").removesuffix("s")
        for word in (unit, plain, _ABBREVIATED.get(plain, "")):
            if word in LENGTHS:
                return LENGTHS[word], word
        try:
            return float(unit), unit
        except ValueError:
            raise RigError(
                f"{unit!r} is not a unit of length; use one of {', '.join(LENGTHS)}, or its size in metres"
            ) from None

    def size(self, name: str, program: str, stored: tuple[float, float] | None = None) -> Size:
        """Return the (width, height) of a camera's image, px, from the user or else from the file (`stored`).
        RigError, which names the `program`, if neither states it."""
        size = (self.sizes or {}).get(name) or stored
        if size is None:
            raise RigError(
                f"{program} does not store the image size: state it for {name!r} (`sizes`, width and height; "
                "on the command line `--size WIDTHxHEIGHT`)"
            )
        return int(size[0]), int(size[1])

    def named(self, count: int, own: Sequence[str] | None = None) -> list[str]:
        """Return the names of `count` cameras: the user's, else the file's (`own`), else cam1, cam2, ...
        RigError if the user gave another number of names."""
        if self.names is None:
            return list(own or (f"cam{n + 1}" for n in range(count)))
        if len(self.names) != count:
            raise RigError(f"it holds {count} cameras, but {len(self.names)} names were given")
        return list(self.names)


@dataclass(frozen=True)
class StoredCamera:
    """A camera as another program's file stores it, with the lens model of OpenCV."""

    K: Array  # (3, 3), px
    D: Array | Sequence[float] | None  # Distortion coefficients in OpenCV's order
    pose: Pose = FIRST_CAMERA
    size: tuple[float, float] | None = None  # Image (width, height), px; None if the file does not store it


def camera_matrix(fx: float, fy: float, cx: float, cy: float, skew: float = 0.0) -> Array:
    """Return OpenCV's camera matrix (3, 3), px."""
    return np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def rig_of_file(
    cameras: Sequence[StoredCamera],
    options: ImportOptions,
    origin: str,
    note: Mapping[str, object],
    own: Sequence[str] | None = None,
) -> Rig:
    """Make a rig of the cameras that a file stores.
    `origin` is the file's name in error messages, and `note` is written to the provenance. The file's own
    camera names, `own`, are used if the user gave none and they are distinct and not empty."""
    if cameras[0].pose is FIRST_CAMERA:
        left_out = "no pose in the world: the frame is that of the first camera; level it on the water"
        note = {"left_out": left_out, **note}
    if own is not None and (not all(own) or len(set(own)) < len(own)):
        own = None
    named = dict(zip(options.named(len(cameras), own), cameras, strict=True))
    return Rig(
        {
            name: Camera.from_opencv(one.K, one.D, *one.pose, options.size(name, origin, one.size))
            for name, one in named.items()
        },
        {"imported": note},
    )


def rotation_near(matrix: Array) -> Array:
    """Return the rotation (3, 3) nearest to a matrix with rounding errors.
    RigError if an element of the rotation differs from the matrix by over 0.001."""
    U, _, V = np.linalg.svd(matrix)
    nearest: Array = U @ V
    if not np.abs(nearest - matrix).max() < 1e-3 or np.linalg.det(nearest) < 0:
        raise RigError("its rotation matrix is not a rotation")
    return nearest


def turned_about_axes(alpha: float, beta: float, gamma: float) -> Array:
    """Return the rotation Rz(gamma) Ry(beta) Rx(alpha), angles in radians, as in VIC-3D, DICe and DaVis."""
    about_x, about_y, about_z = (rotation_about(a * e) for a, e in zip((alpha, beta, gamma), np.eye(3)))
    turn: Array = about_z @ about_y @ about_x
    return turn


def numbers_of(parent: ET.Element, tag: str, count: int | None = None) -> list[float]:
    """Return the numbers in the child element `tag` of an XML element.
    RigError if the child is missing, is empty, or does not hold `count` numbers."""
    element = parent.find(tag)
    if element is None or element.text is None:
        raise RigError(f"<{tag}> is missing")
    values = [float(v) for v in element.text.split()]
    if count is not None and len(values) != count:
        raise RigError(f"<{tag}> holds {len(values)} numbers instead of {count}")
    return values


def refuse_terms(camera: Camera, program: str, *terms: str) -> None:
    """Raise a RigError if a lens term other than `terms`, which `program` supports, is not zero."""
    extra = [
        term
        for term in ("k1", "k2", "p1", "p2", "k3", "tau_x", "tau_y", "skew")
        if term not in terms and getattr(camera, term) != 0.0
    ]
    if extra:
        raise RigError(
            f"{program} does not have {', '.join(extra)}: calibrate again with a model of "
            f"fx, fy, cx, cy{', ' if terms else ''}{', '.join(terms)}"
        )


def as_pair(rig: Rig, program: str) -> tuple[Camera, Camera, Array, Array]:
    """Return the two cameras of a rig, and the pose of the second in the frame of the first.
    The pose is a rotation (3, 3) and a translation (3,), metres. RigError if the rig has not two cameras, or
    holds only their lenses."""
    if len(rig) != 2:
        raise RigError(f"{program} has two cameras, and this rig {len(rig)}: write OpenCV's file")
    if rig.lenses_alone:
        raise RigError(f"{program} needs the position of the second camera, which this rig does not contain")
    one, two = rig.cameras.values()
    R = two.R @ one.R.T
    return one, two, R, two.T - R @ one.T


def refuse_implausible(cameras: Sequence[StoredCamera], unit: str) -> None:
    """Raise a RigError if `unit` is empty and two cameras are over `MAX_DISTANCE` (20 m) apart.
    The file's unit of length is then probably not the metre."""
    centres = [-one.pose[0].T @ one.pose[1] for one in cameras]
    apart = max((float(np.linalg.norm(a - b)) for a in centres for b in centres), default=0.0)
    if not unit and apart > MAX_DISTANCE:
        raise RigError(
            f"it states no unit of length, and in metres its cameras are {apart:.4g} m apart: convert with "
            "its unit, as in `wavefield rig FILE --unit mm -o rig.yaml`"
        )
