"""Target nodes in one image: the class that holds them, and tables of points that other programs found."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import CalibrationError
from wavefield.file_access import refuse_pipe
from wavefield.rig.lens import Array

Image = NDArray[np.float32]  # (row, column); the brightest grey is 255
Nodes = NDArray[np.int64]  # (n, 2): indices (i, j) of a target's nodes
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TargetPoints:
    """Nodes of a target found in one image.

    Parameters
    ----------
    node : ndarray of int, (n, 2)
        Indices (i, j). The node is at x = i * mesh, y = j * mesh on the target, right-handed seen from
        above; mesh is the distance between nodes. For a target of kind `points` these are x and y in units
        of the mesh, and may be fractions.
    pixel : ndarray, (n, 2)
        Position (X, Y) = (column, row), px.
    std : ndarray, (n,)
        Standard uncertainty of the position along each axis, px.
    size : tuple of int
        Image (width, height), px.
    notes : tuple of str
        Remarks for the user, for example on points that were left out.
    z : ndarray, (n,), optional
        Height of each node above the target's plane, metres; None if all nodes are on the plane.
    placed : bool
        Whether nodes and z are known positions in the frame of the rig, as for a target that a traverse
        moves along z.
    """

    node: Nodes
    pixel: NDArray[np.float64]
    std: NDArray[np.float64]
    size: tuple[int, int]
    notes: tuple[str, ...] = field(default=())
    z: NDArray[np.float64] | None = None
    placed: bool = False

    def __len__(self) -> int:
        return len(self.node)


COLUMNS = ("i", "j", "X", "Y")
FREE_COLUMNS = ("x", "y", "z", "X", "Y")


def read_points(
    path: str | Path, size: tuple[int, int] | None = None, std: float = 0.1, unit: float | None = None
) -> TargetPoints:
    """Read target points from a CSV file with columns i, j, X, Y and, optionally, std (px) and z (metres).
    If `unit` (metres) is given, the columns are x, y, z in this unit, X, Y and, optionally, std. The image
    `size` (width, height), px, and `std` are used if they are not in the file."""
    path = Path(path)
    lines = _lines(path)
    # lines that begin with # are comments; one of them may be "# size 1024 1024" (width and height, px)
    size = _stated_size(lines, path) or size
    if size is None:
        raise CalibrationError(
            f"{path} does not state the image's size, and there are no images of its camera; add a line like "
            "'# size 1024 1024'"
        )
    # X, Y count from 0 at the centre of the first pixel; a column z means that the target's pose is known
    data, placed = _table(lines, path, std, unit)
    node = data[:, :2] if unit else np.rint(data[:, :2]).astype(np.int64)
    if not np.isfinite(data).all() or np.any(node != data[:, :2]) or np.any(data[:, 4] <= 0.0):
        raise CalibrationError(f"{path}: i and j must be whole numbers, X and Y finite and std positive")
    if len(np.unique(np.column_stack([node, data[:, 5]]), axis=0)) != len(node):
        raise CalibrationError(f"{path} holds the same node twice; keep one line per node")
    z = data[:, 5] if placed else None
    notes = (f"points read from {path.name}",)
    return TargetPoints(cast(Nodes, node), data[:, 2:4], data[:, 4], size, notes, z, placed)


def _lines(path: Path) -> list[str]:
    try:
        refuse_pipe(path, CalibrationError)
        return path.read_text().splitlines()
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such file of target points") from None
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path} cannot be read as a table of target points: {error}") from None


def _stated_size(lines: list[str], path: Path) -> tuple[int, int] | None:
    """Return the image size (width, height), px, from a comment line of the file; None if there is none."""
    for line in lines:
        words = line.lstrip("#").split()
        if line.startswith("#") and words[:1] == ["size"]:
            try:
                width, height = (int(word) for word in words[1:])
            except ValueError:
                raise CalibrationError(f"{path}: {line!r} must be like '# size 1024 1024'") from None
            return width, height
    return None


def _table(lines: list[str], path: Path, std: float, unit: float | None) -> tuple[Array, bool]:
    """Return the lines of a file as a table (n, 6), and whether the file has a column z.
    The columns of the table are i, j (or x, y in `unit`), X, Y, std, z (metres). `std`, px, replaces missing
    values."""
    rows = [line for line in lines if line.strip() and not line.startswith("#")]
    words = [[w.strip() for w in row.split(",")] if "," in row else row.split() for row in rows]
    header = words[0] if words else []
    missing = [name for name in (COLUMNS if unit is None else FREE_COLUMNS) if name not in header]
    if missing:
        raise CalibrationError(
            f"{path} lacks the column {', '.join(missing)}; its header must be i,j,X,Y, or also std and z "
            "(points that are no grid: kind: points, with x,y,z,X,Y)"
        )
    placed = "z" in header
    default = {"std": std} if placed else {"std": std, "z": 0.0}
    columns = (*(("i", "j") if unit is None else ("x", "y")), "X", "Y", "std", "z")
    table = []
    for count, row in enumerate(words[1:], 1):
        values = dict(zip(header, row, strict=False))
        try:
            table.append([float(values.get(name) or default[name]) for name in columns])
        except (KeyError, ValueError):
            raise CalibrationError(f"{path}: point {count} is not made of numbers: {values}") from None
    out = np.array(table, float).reshape(-1, len(columns))
    out[:, 5] *= unit or 1.0
    return out, placed
