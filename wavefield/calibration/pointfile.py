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
    """Read target points from a CSV file with columns i, j, X, Y and, where available, std (px) and z (m).
    size and std are used where the file states none; CalibrationError for a line that makes no sense.
    """
    path = Path(path)
    lines = _lines(path)
    # lines that begin with # are comments, of which one may be: # size 1024 1024 (width and height)
    size = _stated_size(lines, path) or size
    if size is None:
        raise CalibrationError(
            f"{path} does not state the image's size, and there are no images of its camera; add a line like "
            "'# size 1024 1024'"
        )
    # node (i, j) is at x = i * mesh, y = j * mesh, right-handed seen from above; X, Y are column and row, px,
    # from 0 at the centres of pixels; z in the physical frame gives the view's pose, as of a traversed target
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
