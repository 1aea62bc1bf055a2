"""Target points found by another program, or by hand, as a table in a text file."""

import csv
from pathlib import Path

import numpy as np

from wavefield.calibration.points import TargetPoints
from wavefield.errors import CalibrationError

COLUMNS = ("i", "j", "X", "Y")


def read_points(path: str | Path, size: tuple[int, int] | None = None, std: float = 0.1) -> TargetPoints:
    """Read target points from a CSV file.

    The file has a header `i,j,X,Y` or `i,j,X,Y,std`: indices of the node (right-handed seen from above,
    node at x = i * mesh, y = j * mesh), its pixel coordinates (column, row; 0-based, centres of pixels at
    integers) and, if known, its standard uncertainty per axis in px. Lines that begin with `#` are
    comments; a line `# size 1024 1024` states width and height of the image.

    Parameters
    ----------
    path : path
        File to read.
    size : tuple of int, optional
        Image (width, height), px; needed when the file does not state it.
    std : float, default 0.1
        Standard uncertainty of points for which the file states none, px.

    Returns
    -------
    TargetPoints

    Raises
    ------
    CalibrationError
        If the file is missing, has no such columns, or holds something else than numbers.

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
    try:
        lines = path.read_text().splitlines()
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such file of target points") from None
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path} cannot be read as a table of target points: {error}") from None
    for line in lines:
        words = line.lstrip("#").split()
        if line.startswith("#") and len(words) == 3 and words[0] == "size":
            size = (int(words[1]), int(words[2]))
    if size is None:
        raise CalibrationError(f"{path} does not state the image's size; add a line like '# size 1024 1024'")
    rows = csv.DictReader(
        (line for line in lines if line.strip() and not line.startswith("#")), skipinitialspace=True
    )
    missing = [name for name in COLUMNS if name not in (rows.fieldnames or ())]
    if missing:
        raise CalibrationError(
            f"{path} lacks the column {', '.join(missing)}; its header must be i,j,X,Y or i,j,X,Y,std"
        )
    table = []
    for count, row in enumerate(rows, 1):
        try:
            table.append([float(row[name]) for name in COLUMNS] + [float(row.get("std") or std)])
        except (TypeError, ValueError):
            raise CalibrationError(f"{path}: point {count} is not made of numbers: {dict(row)}") from None
    data = np.array(table, float).reshape(-1, 5)
    node = np.rint(data[:, :2]).astype(np.int64)
    if not np.isfinite(data).all() or np.any(node != data[:, :2]) or np.any(data[:, 4] <= 0.0):
        raise CalibrationError(f"{path}: i and j must be whole numbers, X and Y finite and std positive")
    if len(np.unique(node, axis=0)) != len(node):
        raise CalibrationError(f"{path} holds the same node twice; keep one line per node")
    return TargetPoints(node, data[:, 2:4], data[:, 4], size, (f"points read from {path.name}",))


def write_points(path: str | Path, points: TargetPoints) -> None:
    """Write target points as a CSV file that `read_points` reads.

    Parameters
    ----------
    path : path
        File to write; its folder is made.
    points : TargetPoints
        What to write.
    """
    lines = [f"# size {points.size[0]} {points.size[1]}", "i,j,X,Y,std"]
    for (i, j), (x, y), std in zip(points.node, points.pixel, points.std):
        lines.append(f"{i},{j},{float(x)!r},{float(y)!r},{float(std)!r}")
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
