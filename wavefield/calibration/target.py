"""What a calibration target is."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

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
