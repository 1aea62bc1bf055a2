"""What a calibration target is, and finding it in an image whatever its kind."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.calibration.points import TargetPoints
from wavefield.errors import CalibrationError

KINDS = ("strings", "chessboard", "dots", "charuco")


@dataclass(frozen=True)
class Target:
    """A plane calibration target, as the `target:` block of the experiment file describes it.

    The axes of the target are right-handed seen from its printed (or upper) side: x along the first
    index, y along the second, z out of it towards the camera.

    Parameters
    ----------
    kind : {"strings", "chessboard", "dots", "charuco"}
        White strings stretched across a dark ground; chessboard corners; centres of round dots; the
        chessboard corners of a ChArUco board.
    mesh : float
        Distance between neighbouring nodes, metres.
    shape : tuple of int, optional
        Nodes along x and along y. Needed for a chessboard (inner corners) and for dots; for ChArUco the
        number of *squares* along x and y, as its makers count. A grid of strings needs none.
    origin_mark, x_mark : str
        Marks of a grid of strings: a disc on the node (0, 0), a smaller one on (1, 0).
    diameter : float, optional
        Diameter of a dot, metres. With it the bias of a dot's centroid in perspective is removed.
    dictionary : str
        ChArUco: OpenCV's name of the marker dictionary.
    marker : float, optional
        ChArUco: side of a marker, metres.
    origin : (float, float)
        Where node (0, 0) of the flat target lies in the physical frame, metres.

    Raises
    ------
    CalibrationError
        If a value is missing or makes no sense for this kind.

    Examples
    --------
    >>> Target("strings", mesh=0.10).mesh
    0.1
    >>> Target.from_dict({"kind": "chessboard", "mesh": 0.03, "shape": [9, 6]}).shape
    (9, 6)
    """

    kind: str
    mesh: float
    shape: tuple[int, int] | None = None
    origin_mark: str = "disc"
    x_mark: str = "small disc"
    diameter: float | None = None
    dictionary: str = "DICT_4X4_50"
    marker: float | None = None
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:  # noqa: C901
        if self.kind not in KINDS:
            raise CalibrationError(f"target kind {self.kind!r} is not known; use one of {', '.join(KINDS)}")
        object.__setattr__(self, "mesh", _length("mesh", self.mesh))
        if self.shape is not None:
            try:
                nx, ny = (int(n) for n in self.shape)
            except (TypeError, ValueError):
                raise CalibrationError(
                    f"target shape {self.shape!r} must be two whole numbers, nodes along x and along y"
                ) from None
            if min(nx, ny) < 3:
                raise CalibrationError(f"target shape {nx} x {ny} is too small; use at least 3 x 3")
            object.__setattr__(self, "shape", (nx, ny))
        elif self.kind != "strings":
            raise CalibrationError(f"a {self.kind} target needs its shape, for example shape: [9, 6]")
        if self.kind == "strings" and (self.origin_mark, self.x_mark) != ("disc", "small disc"):
            raise CalibrationError(
                "a grid of strings is marked by origin_mark: disc and x_mark: small disc, and no others"
            )
        try:
            x, y = (float(v) for v in self.origin)
        except (TypeError, ValueError):
            raise CalibrationError(
                f"target origin {self.origin!r} must be two numbers: x and y of node (0, 0), metres"
            ) from None
        object.__setattr__(self, "origin", (x, y))
        if self.diameter is not None:
            object.__setattr__(self, "diameter", _length("diameter", self.diameter))
            if self.diameter >= self.mesh:  # type: ignore[operator]
                raise CalibrationError(
                    "the target's dots are larger than its mesh; check diameter and mesh (metres)"
                )
        if self.kind == "charuco":
            if self.marker is None:
                raise CalibrationError(
                    "a charuco target needs the side of its markers, for example marker: 0.02"
                )
            object.__setattr__(self, "marker", _length("marker", self.marker))
            if self.marker >= self.mesh:  # type: ignore[operator]
                raise CalibrationError(
                    "the target's markers are larger than its squares; check marker and mesh (metres)"
                )

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Target":
        """A target from the `target:` block of an experiment file.

        Parameters
        ----------
        data : mapping
            Names and values of the parameters of `Target`.

        Returns
        -------
        Target

        Raises
        ------
        CalibrationError
            If a name is unknown or a value is missing or makes no sense.
        """
        known = [f.name for f in fields(cls)]
        unknown = [str(name) for name in data if name not in known]
        if unknown:
            raise CalibrationError(f"target: {', '.join(unknown)} is not known; use {', '.join(known)}")
        for name in ("kind", "mesh"):
            if name not in data:
                raise CalibrationError(f"target: {name} is missing")
        return cls(**data)


def _length(name: str, value: Any) -> float:
    try:
        length = float(value)
    except (TypeError, ValueError):
        length = float("nan")
    if not 0.0 < length < 100.0:
        raise CalibrationError(
            f"target {name} {value!r} must be a positive length in metres, for example 0.10"
        )
    return length


def find_target(image: NDArray[Any], target: Target) -> TargetPoints:
    """Find the nodes of a calibration target in one image.

    Parameters
    ----------
    image : ndarray, (row, column), any real dtype
        The image; bright where the strings are white.
    target : Target
        What to look for.

    Returns
    -------
    TargetPoints
        Indices of the nodes found, their pixel coordinates and standard uncertainties.

    Raises
    ------
    CalibrationError
        If the image is empty or overexposed, or shows no such target, or a mirrored one, or too little of it.
    """
    from wavefield.calibration import patterns, strings

    grey = _check(image)
    finders = {
        "strings": strings.find_strings,
        "chessboard": patterns.find_chessboard,
        "dots": patterns.find_dots,
        "charuco": patterns.find_charuco,
    }
    try:
        return finders[target.kind](grey, target)
    except CalibrationError as error:
        saturated = float(np.mean(grey >= grey.max()))
        if saturated > 0.2:
            raise CalibrationError(
                f"{error}; {saturated:.0%} of the image is overexposed: photograph it again with less light"
            ) from None
        raise


def _check(image: NDArray[Any]) -> NDArray[np.float32]:
    """The image as float32 with its brightest grey at 255, refused when there is nothing to see in it."""
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < 32:
        raise CalibrationError(f"a target image must be one grey image of 32 px or more, not {image.shape}")
    grey = image.astype(np.float32)
    if not np.isfinite(grey).all():
        raise CalibrationError("the image holds values that are not numbers; export it from the camera again")
    low, high = float(grey.min()), float(grey.max())
    if high - low < 4.0 / 255.0 * max(abs(high), 1e-12):
        raise CalibrationError(
            "the image is empty: all its pixels have one grey; check light, cap and exposure"
        )
    return grey * np.float32(255.0 / high)
