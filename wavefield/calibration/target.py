"""Description of a calibration target: its pattern and dimensions.

A node is a marked point of the target: a string crossing, a chessboard corner or the centre of a dot.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass

from wavefield.config_files import make
from wavefield.errors import CalibrationError


def _metres(value: object) -> object:
    """Return `value` if it is None or a plausible length in metres; else raise a ValueError."""
    try:
        sound = value is None or 5e-5 < float(value) < 2  # type: ignore[arg-type]
    except (TypeError, ValueError):
        sound = False
    if not sound:
        raise ValueError(f"give metres, above 0.00005 and below 2 (0.05 for 5 cm), not {value!r}")
    return value


Length = Annotated[float, BeforeValidator(_metres)]
Nodes = Annotated[int, Field(ge=3)]


@dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Target:
    """A plane calibration target, as the `target:` block of the experiment file describes it.

    The target's axes are right-handed. x follows the first node index, y the second, and z points out of
    the printed (or upper) side, towards the camera.

    Parameters
    ----------
    kind : {"strings", "chessboard", "dots", "charuco", "two-level", "points"}
        Pattern.
    mesh : float
        Distance between neighbouring nodes, m. For a two-level target it is the distance between rows, which
        is half of the spacing within a row. For points it is the unit of the tables (0.001 for mm).
    shape : tuple of int, optional
        Number of nodes along x and y. A chessboard counts inner corners, a ChArUco board counts squares.
    origin_mark : {"disc", "square"}
        Mark of node (0, 0) of strings: a disc. A two-level target has a square at (0, 1), between the dots.
    x_mark : {"small disc", "triangle"}
        Mark of the x axis. Strings: a small disc at node (1, 0). Two-level: a triangle at (1, 0), between
        the dots.
    diameter : float, optional
        Diameter of a dot, m.
    dictionary : str
        OpenCV's name of the dictionary of ChArUco markers.
    marker : float, optional
        Side of a ChArUco marker, m.
    depth : float, optional
        Two-level: depth of the second level below the level that holds the origin, m; negative if it is
        above.
    origin : (float, float)
        Position (x, y) of node (0, 0) in the frame of the rig when the target lies on z = 0, m.

    Raises
    ------
    ValueError
        If a value is missing or makes no sense for this kind.

    Examples
    --------
    >>> Target("strings", mesh=0.10).mesh
    0.1
    >>> Target.from_dict({"kind": "chessboard", "mesh": 0.03, "shape": [9, 6]}).shape
    (9, 6)
    """

    kind: Literal["strings", "chessboard", "dots", "charuco", "two-level", "points"]
    mesh: Length
    shape: tuple[Nodes, Nodes] | None = None
    origin_mark: Literal["disc", "square"] = "disc"
    x_mark: Literal["small disc", "triangle"] = "small disc"
    diameter: Length | None = None
    dictionary: str = "DICT_4X4_50"
    marker: Length | None = None
    depth: Annotated[float, Field(gt=-1, lt=1)] | None = None
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if self.kind == "two-level" and not self.depth:
            raise ValueError("a two-level target needs its depth, for example depth: 0.002 (metres)")
        if self.shape is None and self.kind not in ("strings", "two-level", "points"):
            raise ValueError(f"a {self.kind} target needs its shape, for example shape: [9, 6]")
        if self.diameter is not None and self.diameter >= self.mesh:
            raise ValueError("the target's dots are larger than its mesh; check diameter and mesh (metres)")
        if self.kind == "charuco":
            if self.marker is None:
                raise ValueError("a charuco target needs the side of its markers, for example marker: 0.02")
            if self.marker >= self.mesh:
                raise ValueError(
                    "the target's markers are larger than its squares; check marker and mesh (metres)"
                )

    @classmethod
    def from_dict(cls, data: Mapping[str, object], path: Path | None = None) -> "Target":
        """Build a target from the `target:` block of an experiment file.

        Parameters
        ----------
        data : mapping
            Names and values of the parameters of `Target`.
        path : path, optional
            The experiment file. Error messages name it, with the line at fault.

        Raises
        ------
        CalibrationError
            If a name is unknown or a value is missing or makes no sense.
        """
        location = ("calibration", "target") if path else ("target",)
        return make(cls, data, path=path, location=location, error=CalibrationError)
