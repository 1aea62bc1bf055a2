"""Target points found by another program, or by hand, as a table in a text file."""

import csv
from pathlib import Path

import numpy as np

from wavefield.calibration.points import TargetPoints
from wavefield.errors import CalibrationError
from wavefield.file_access import accessing
from wavefield.rig.lens import Array

COLUMNS = ("i", "j", "X", "Y")


def read_points(path: str | Path, size: tuple[int, int] | None = None, std: float = 0.1) -> TargetPoints:
    """Read target points from a CSV file; size and std (px) are used where the file states none.

    The file has a header `i,j,X,Y`, and `std` and `z` where available: indices of the node (right-handed seen
    from above, node at x = i * mesh, y = j * mesh), its pixel coordinates (column, row; 0-based, centres of
    pixels at integers), its standard uncertainty per axis in px. With z, the node's height in the physical
    frame in metres, the view's pose is given: as for a target that a traverse moves along z. Lines that
    begin with `#` are comments; a line `# size 1024 1024` states width and height of the image.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> points = TargetPoints(np.array([[0, 1]]), np.array([[10.5, 20.25]]), np.array([0.01]), (64, 48))
    >>> with TemporaryDirectory() as folder:
    ...     write_points(folder + "/points.csv", points)
    ...     print(read_points(folder + "/points.csv").pixel)
    [[10.5  20.25]]
    """
    path = Path(path)
    lines = _lines(path)
    size = _stated_size(lines, path) or size
    if size is None:
        raise CalibrationError(
            f"{path} does not state the image's size, and there are no images of its camera; add a line like "
            "'# size 1024 1024'"
        )
    data, placed = _table(lines, path, std)
    node = np.rint(data[:, :2]).astype(np.int64)
    if not np.isfinite(data).all() or np.any(node != data[:, :2]) or np.any(data[:, 4] <= 0.0):
        raise CalibrationError(f"{path}: i and j must be whole numbers, X and Y finite and std positive")
    if len(np.unique(np.column_stack([node, data[:, 5]]), axis=0)) != len(node):
        raise CalibrationError(f"{path} holds the same node twice; keep one line per node")
    z = data[:, 5] if placed else None
    notes = (f"points read from {path.name}",)
    return TargetPoints(node, data[:, 2:4], data[:, 4], size, notes, z, placed)


def _lines(path: Path) -> list[str]:
    try:
        with accessing(path, CalibrationError):
            return path.read_text().splitlines()
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such file of target points") from None
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path} cannot be read as a table of target points: {error}") from None


def _stated_size(lines: list[str], path: Path) -> tuple[int, int] | None:
    for line in lines:
        words = line.lstrip("#").split()
        if line.startswith("#") and words[:1] == ["size"]:
            try:
                width, height = (int(word) for word in words[1:])
            except ValueError:
                raise CalibrationError(f"{path}: {line!r} must be like '# size 1024 1024'") from None
            return width, height
    return None


def _table(lines: list[str], path: Path, std: float) -> tuple[Array, bool]:
    """Columns i, j, X, Y, std, z, and whether the file has z."""
    rows = csv.DictReader(
        (line for line in lines if line.strip() and not line.startswith("#")), skipinitialspace=True
    )
    header = rows.fieldnames or ()
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise CalibrationError(
            f"{path} lacks the column {', '.join(missing)}; its header must be i,j,X,Y, or also std and z"
        )
    table = []
    for count, row in enumerate(rows, 1):
        try:
            values = [float(row[name]) for name in COLUMNS]
            table.append([*values, float(row.get("std") or std), float(row["z"]) if "z" in header else 0.0])
        except (TypeError, ValueError):
            raise CalibrationError(f"{path}: point {count} is not made of numbers: {dict(row)}") from None
    return np.array(table, float).reshape(-1, 6), "z" in header
