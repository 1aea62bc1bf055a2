"""Read the elevations of wave probes from a CSV file."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError
from wavefield.file_access import refuse_pipe
from wavefield.rig.formats.common import LENGTHS
from wavefield.variables import annotate

if TYPE_CHECKING:  # half a second to import
    import xarray as xr

SLOWEST = 2.0  # s between samples: slower ones do not resolve waves; times in ms have steps of 10 and more
LARGEST = 40.0  # m from the lowest to the highest value: no wave is higher


def read_probes(
    path: str | Path,
    *,
    unit: str = "m",
    factor: float = 1.0,
    clock: float = 0.0,
    places: Mapping[str, tuple[float, float]] | None = None,
) -> "xr.Dataset":
    """Read the elevations of wave probes from a CSV file.

    Parameters
    ----------
    path : path-like
        UTF-8 text, columns separated by commas. The first line names the columns: ``time`` (seconds,
        increasing; frame 0 is at 0) and one column per probe. A cell that is empty or ``nan`` is a missing
        value. Lines that begin with ``#`` are comments.
    unit : {"m", "cm", "mm", "um"}
        Unit of the elevations.
    factor : float
        Multiplies the elevations, such as -1 for gauges that count downwards.
    clock : float
        Added to the times, s.
    places : mapping of str to (float, float), optional
        x, y of the probes, m.

    Returns
    -------
    Dataset
        ``elevation`` (probe, time), m; coordinates ``probe`` (name), ``probe_x``, ``probe_y`` (m, NaN where
        `places` has none).

    Raises
    ------
    ExperimentError
        If the file cannot be read or is not such a table, if its values are implausible for waves in this
        unit, or if `places` names a probe that the file lacks.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "probes.csv"
    >>> _ = path.write_text("time,p1,p2\\n0.00,1.5,-2.5\\n0.01,1.2,\\n")
    >>> read_probes(path, unit="mm").elevation.values.tolist()
    [[0.0015, 0.0012], [-0.0025, nan]]
    """
    path = Path(path)
    lines = numbered_lines(path, "the probes")
    if unit not in LENGTHS:
        raise ExperimentError(f"the probes {path}: unit {unit!r} is not one of {', '.join(LENGTHS)}")
    names = _names(path, *lines[0]) if lines else []
    if len(lines) < 3:
        raise ExperimentError(f"the probes {path} have fewer than two lines of numbers")
    table = _table(path, names, lines[1:])
    _check_times(path, table[:, 0], [number for number, _ in lines[1:]])
    for name, values in zip(names[1:], table[:, 1:].T):
        _check_elevation(path, name, values * LENGTHS[unit] * factor)
    unknown = [name for name in places or {} if name not in names[1:]]
    if unknown:
        raise ExperimentError(
            f"`places` names {unknown[0]!r}, but the probes of {path} are {', '.join(names[1:])}"
        )
    nowhere = (np.nan, np.nan)
    x, y = np.array([(places or {}).get(name, nowhere) for name in names[1:]], float).T
    import xarray as xr

    out = xr.Dataset(
        {"elevation": (("probe", "time"), LENGTHS[unit] * factor * table[:, 1:].T)},
        {
            "time": ("time", table[:, 0] + clock),
            "probe": ("probe", names[1:]),
            "probe_x": ("probe", x),
            "probe_y": ("probe", y),
        },
    )
    return annotate(out, "probes")


def numbered_lines(path: Path, what: str) -> list[tuple[int, str]]:
    """Return the lines of a UTF-8 file as (number from 1, text), without blank lines and comments (#).
    ExperimentError if the file cannot be read; its message calls the content of the file `what`."""
    try:
        refuse_pipe(path, ExperimentError)
        data = path.read_bytes()
    except OSError as error:
        raise ExperimentError(f"cannot read {what} {path}: {error.strerror}") from None
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ExperimentError(
            f"{path}, line {line}: byte 0x{data[error.start]:02x} is not UTF-8 text; save {what} as CSV "
            "in UTF-8"
        ) from None
    return [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]


def _names(path: Path, number: int, line: str) -> list[str]:
    """Return the column names in `line`, the header ``time,NAME,...`` of a probe file, at line `number`."""
    names = [name.strip().strip('"') for name in line.split(",")]
    odd = any(not name or set(name) & set("[](){}") for name in names)
    if len(names) < 2 or names[0] != "time" or odd or len(set(names)) < len(names):
        raise ExperimentError(
            f"{path}, line {number}: the first line must be `time,NAME,NAME,...` with the names of probes, "
            f"commas and no brackets (`unit:` is in the experiment file), and it is {line.strip()[:60]!r}"
        )
    return names


def _table(path: Path, names: list[str], lines: list[tuple[int, str]]) -> NDArray[np.float64]:
    """Return the numbers in `lines`, pairs of (line number, text), as an array (line, column).
    Empty cells become NaN. ExperimentError if a line does not hold one number for each of `names`."""
    table = np.empty((len(lines), len(names)))
    for row, (number, line) in zip(table, lines):
        cells = [cell.strip() or "nan" for cell in line.split(",")]
        try:
            row[:] = np.array(cells, float) if len(cells) == len(names) else np.inf
        except ValueError:
            row[:] = np.inf
        if np.isinf(row).any():
            raise ExperimentError(
                f"{path}, line {number}: {line.strip()[:60]!r} is not {len(names)} numbers; times are in "
                "seconds, and a cell without a value is empty"
            )
    return table


def _check_times(path: Path, times: NDArray[np.float64], numbers: list[int]) -> None:
    """Raise ExperimentError if times, s, do not increase, or if their median interval is over 2 s.
    The message names a line of the file; `numbers` has the line number of each time."""
    steps = np.diff(times)
    if not (steps > 0).all():
        later = int(np.argmin(steps > 0)) + 1
        raise ExperimentError(f"{path}, line {numbers[later]}: time is not increasing")
    step = float(np.median(steps))
    if step > SLOWEST:
        raise ExperimentError(
            f"{path}: the times are {step:g} apart, too slow for waves if they are seconds; write them in "
            "seconds, frame 0 at 0"
        )


def _check_elevation(path: Path, name: str, elevation: NDArray[np.float64]) -> None:
    """Raise ExperimentError if elevations of the probe `name`, m, vary by over 40 m.
    Such a range means a wrong unit, or missing values that are written as -99.99."""
    known = elevation[np.isfinite(elevation)]
    if known.size and np.ptp(known) > LARGEST:
        raise ExperimentError(
            f"{path}: {name} varies by {np.ptp(known):.3g} m, more than any wave; state `unit:` in "
            "`probes:`, and leave cells without a value empty"
        )
