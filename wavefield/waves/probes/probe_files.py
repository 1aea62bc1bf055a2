"""Wave probes: reading their file, and their spectrum on the frequencies of the cube's."""

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from wavefield.errors import CubeError, ExperimentError
from wavefield.file_access import accessing
from wavefield.variables import annotate
from wavefield.water import GRAVITY
from wavefield.waves.estimation.welch import LOWEST, Welch, omega_coords
from wavefield.waves.estimation.windows import degrees_of_freedom, hann, interval, segment_count
from wavefield.waves.products import Product, register

Array = NDArray[Any]
LONGEST_GAP = 3  # samples that are bridged
MAX_STD = 0.5  # m: higher waves are compared with their length
MAX_STEEPNESS = 0.2  # significant height over the length of a wave of the mean period: breaking ones have 0.1
MIN_SEGMENTS_FOR_COHERENCE = 4
COHERENCE_LINES = 9  # over which it is averaged


@dataclass(frozen=True)
class Columns:
    """Which columns of a laboratory's file are what."""

    time: str | int  # Name in the header, or number from 1 where there is no header
    probes: Mapping[str, str | int]  # The same for every probe, by the name that it gets


def read_probes(
    path: str | Path,
    columns: Columns | None = None,
    *,
    unit: str = "",
    factor: float = 1.0,
    clock: float = 0.0,
    places: Mapping[str, tuple[float, float]] | None = None,
) -> xr.Dataset:
    """Read a file of probes.

    Parameters
    ----------
    path : path-like
        Table with a header, columns parted by commas, semicolons, tabs or blanks: a column of time (``time``,
        ``t``; s or ms) and one per probe. Units are in brackets in the header, as in ``p1 [mm]``, or in a
        line ``# unit mm``; without any they are metres. Lines ``# name x y`` give positions, m.
        With `columns` lines above the header and columns that are not named are passed over, and numbers may
        have decimal commas where columns are parted otherwise.
    columns : Columns, optional
        Which columns are what, where the header does not state it.
    unit : str
        Of the probes, where the file does not state it: m, cm, mm, um.
    factor : float
        On their values, such as -1 for gauges that count downwards.
    clock : float
        Added to their times, s.
    places : mapping of str to (float, float), optional
        Their positions, m, in place of those in the file.

    Returns
    -------
    Dataset
        ``elevation`` (probe, time), m; coordinates ``probe`` (name), ``probe_x``, ``probe_y`` (m, NaN if not
        given).

    Raises
    ------
    ExperimentError
        If the file cannot be read, a line does not fit the header, time is not increasing, or the numbers are
        no metres; the message names the line.

    Notes
    -----
    An empty cell, or one with nan, is a missing value of that probe at that time alone.
    """
    path = Path(path)
    try:
        with accessing(path, ExperimentError):
            lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise ExperimentError(f"cannot read the probes {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ExperimentError(f"the probes {path} are not a text file; write them as CSV") from None
    known = _places(lines) | dict(places or {})
    unit = unit or _unit_of(lines, path)
    if unit and unit not in _UNITS:
        raise ExperimentError(f"the probes {path}: unit {unit!r} is not known; use m, cm or mm")
    body = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if columns is not None:
        body = _chosen(path, body, columns)
    found, separator = _header(path, body, unit)
    table = _table(path, body[1:], found, separator)
    table[:, 0] += clock
    table[:, 1:] *= factor
    names = [column.name for column in found[1:]]
    nowhere = (np.nan, np.nan)
    out = xr.Dataset(
        {"elevation": (("probe", "time"), table[:, 1:].T)},
        {
            "time": ("time", table[:, 0]),
            "probe": ("probe", names),
            "probe_x": ("probe", [known.get(n, nowhere)[0] for n in names]),
            "probe_y": ("probe", [known.get(n, nowhere)[1] for n in names]),
        },
    )
    return annotate(out, "probes")


def _chosen(path: Path, body: list[tuple[int, str]], columns: Columns) -> list[tuple[int, str]]:
    """The table of the named columns alone, with a header of our own."""
    requested = [columns.time, *columns.probes.values()]
    separator = _separator([line for _, line in body])
    cells = [(k, [cell.strip().strip('"') for cell in line.split(separator)]) for k, line in body]
    if all(isinstance(one, int) for one in requested):
        at = [int(one) - 1 for one in requested]
        first = next((i for i, (_, row) in enumerate(cells) if _numeric(row, at)), None)
        if first is None:
            raise ExperimentError(
                f"the probes {path}: no line has numbers in the columns {', '.join(map(str, requested))}"
            )
        units = [""] * len(at)
    else:
        plain = [[re.sub(r"\s*[\[(]\s*\w*\s*[\])]$", "", cell) for cell in row] for _, row in cells]
        head = next(
            (i for i, row in enumerate(plain) if all(_named(one, row, cells[i][1]) for one in requested)),
            None,
        )
        if head is None:
            known = max((row for _, row in cells[:20]), key=len, default=[])
            raise ExperimentError(
                f"the probes {path}: no header has the columns {', '.join(map(str, requested))}; there is "
                f"{', '.join(known[:12]) or 'nothing'}"
            )
        raw = cells[head][1]
        at = [_place(one, plain[head], raw) for one in requested]
        units = [match[0] if (match := re.search(r"[\[(]\s*\w+\s*[\])]$", raw[i])) else "" for i in at]
        first = head + 1
    header = ",".join(f"{name} {unit}" for name, unit in zip(("time", *columns.probes), units))
    rows = [(body[max(first - 1, 0)][0], header)]
    for k, row in cells[first:]:
        if len(row) <= max(at):
            raise ExperimentError(f"{path}, line {k}: {len(row)} columns, but column {max(at) + 1} is named")
        values = [row[i].replace(",", ".") if separator != "," else row[i] for i in at]
        rows.append((k, ",".join(values)))
    return rows


def _separator(lines: list[str]) -> str | None:
    """What parts the columns; None for blanks, between numbers that may have decimal commas."""
    parted = max(";\t,", key=lambda mark: sum(mark in line for line in lines))
    count = sum(parted in line for line in lines)
    blank = sum(len(line.split()) > 1 and all(map(_is_number, line.split())) for line in lines)
    return None if blank > 0.5 * len(lines) or not count else parted


def _is_number(word: str) -> bool:
    return bool(re.fullmatch(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|(?i:nan)", word))


def _numeric(row: list[str], at: list[int]) -> bool:
    if len(row) <= max(at):
        return False
    return all(re.fullmatch(r"[-+]?[\d.,]+([eE][-+]?\d+)?", row[i]) for i in at)


def _named(one: str | int, plain: list[str], raw: list[str]) -> bool:
    return (isinstance(one, int) and 0 < one <= len(raw)) or one in plain or one in raw


def _place(one: str | int, plain: list[str], raw: list[str]) -> int:
    if isinstance(one, int):
        return one - 1
    return raw.index(one) if one in raw else plain.index(one)


def _places(lines: list[str]) -> dict[str, tuple[float, float]]:
    """Positions of probes, from comments of three words whose last two are numbers."""
    out = {}
    for line in lines:
        words = line.lstrip("#").split()
        if line.startswith("#") and len(words) == 3:
            try:
                out[words[0]] = float(words[1]), float(words[2])
            except ValueError:
                continue  # a remark of three words
    return out


_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "um": 1e-6, "s": 1.0, "ms": 0.001}
MAX_HEADER_LINES = 40  # of a logger's file, before its numbers
_TIME_HEAD = re.compile(r"(time|zeit|temps|tiempo|tempo|t|sec|secs|seconds)\b", re.IGNORECASE)
_TIMES = ("time", "t", "zeit", "temps", "tiempo")


class _Column(NamedTuple):
    name: str
    factor: float  # to metres, or seconds
    stated: bool  # whether the file states its unit


def _unit_of(lines: list[str], path: Path) -> str:
    """Unit of all probes, from a line ``# unit mm``."""
    for k, line in enumerate(lines, 1):
        words = line.lstrip("#").replace(":", " ").split()
        if line.startswith("#") and len(words) == 2 and words[0].lower() in ("unit", "units"):
            if words[1] not in _UNITS:
                raise ExperimentError(f"{path}, line {k}: unit {words[1]!r} is not known; use m, cm or mm")
            return words[1]
    return ""


def _header(path: Path, body: list[tuple[int, str]], unit: str) -> tuple[list[_Column], str | None]:
    if not body:
        raise ExperimentError(f"the probes {path} are empty")
    number, line = body[0]
    mark = max(",;\t", key=line.count)
    separator = mark if mark in line else None  # blanks
    if separator is None:  # they may also precede a unit
        line = re.sub(r"\s+([\[(])\s*(\w+)\s*([\])])", r"\1\2\3", line)
    columns: list[_Column] = []
    for word in line.split(separator):
        match = re.fullmatch(r"(.*?)\s*(?:[\[(]\s*(\w+)\s*[\])])?", word.strip().strip('"'))
        name, own = (match[1], match[2] or "") if match else (word.strip(), "")
        if own and own not in _UNITS:
            raise ExperimentError(f"{path}, line {number}: unit {own!r} is not known; use m, cm, mm, s or ms")
        own = own or ("" if not columns else unit)
        columns.append(_Column(name, _UNITS.get(own, 1.0), bool(own)))
    if len(columns) < 2 or columns[0].name.lower() not in _TIMES:
        form = _columns_form([text for _, text in body], path.name)
        remedy = f", or name the columns in the experiment file: `probes: {form}`" if form else ""
        raise ExperimentError(
            f"{path}, line {number}: no header 'time,<names>': write one above the numbers{remedy}"
        )
    return columns, separator


def suggested_columns(path: Path, name: str) -> str:
    """The form of `probes:` that names the columns of a file with another header; empty without a table."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError):
        return ""
    return _columns_form([line for line in lines if line.strip() and not line.startswith("#")], name)


def _columns_form(lines: list[str], name: str) -> str:
    separator = _separator(lines)
    rows = [[cell.strip().strip('"') for cell in line.split(separator)] for line in lines[:MAX_HEADER_LINES]]
    of_numbers = [len(row) > 1 and all(_is_number(cell) for cell in row if cell) for row in rows]
    if not any(of_numbers):
        return ""
    first = of_numbers.index(True)
    width = len(rows[first])
    head = rows[first - 1] if first and len(rows[first - 1]) == width else []
    if not head or not all(head):  # by their numbers
        columns = ", ".join(f"p{k}: {k + 1}" for k in range(1, width))
        return f"{{file: {name}, time: 1, columns: {{{columns}}}}}"
    time = next((k for k, cell in enumerate(head) if _TIME_HEAD.match(cell)), 0)
    parts = [f'{_probe_name(cell, k)}: "{cell}"' for k, cell in enumerate(head) if k != time]
    return f'{{file: {name}, time: "{head[time]}", columns: {{{", ".join(parts)}}}}}'


def _probe_name(cell: str, k: int) -> str:
    """A name for the probe of a column: its header without unit and blanks."""
    plain = re.sub(r"\s*[\[(].*$", "", cell)
    return re.sub(r"\W+", "", plain) or f"p{k}"


def _table(path: Path, body: list[tuple[int, str]], columns: list[_Column], separator: str | None) -> Array:
    rows = []
    for number, line in body:
        words = line.split(separator)
        if len(words) != len(columns):
            raise ExperimentError(
                f"{path}, line {number}: {len(words)} values, but the header names {len(columns)} columns"
            )
        try:
            decimal = words if separator == "," else [word.replace(",", ".") for word in words]
            rows.append([float(word.strip() or "nan") for word in decimal])
        except ValueError as error:
            raise ExperimentError(
                f"{path}, line {number}: {str(error).split(': ')[-1]} is no number; where there is no value "
                "leave the cell empty"
            ) from None
    if len(rows) < 2:
        raise ExperimentError(f"the probes {path} hold {len(rows)} lines of numbers; two at least are needed")
    table = np.array(rows) * [column.factor for column in columns]
    rising = np.diff(table[:, 0]) > 0
    if not rising.all():
        raise ExperimentError(f"{path}, line {body[int(np.argmin(rising)) + 1][0]}: time is not increasing")
    for k, column in enumerate(columns[1:], 1):
        known = np.isfinite(table[:, k])
        values = table[known, k]
        if values.size and not column.stated and _too_steep(table[known, 0], values):
            raise ExperimentError(
                f"{path}: {column.name} varies by {values.std():.3g} m; if these are millimetres write "
                f"'{column.name} [mm]' into the header or add a line '# unit mm' (m, if they are metres)"
            )
    return table


def _too_steep(time: Array, values: Array) -> bool:
    """Whether an elevation, metres, is too high for waves of its mean period: then it is in another unit."""
    height = 4 * float(values.std())
    if height <= 4 * MAX_STD:
        return False
    crossings = np.count_nonzero(np.diff(values > values.mean()))
    period = 2 * float(time[-1] - time[0]) / max(int(crossings), 1)
    return height > MAX_STEEPNESS * GRAVITY * period**2 / (2 * np.pi)


def probe_spectra(probes: xr.Dataset, omega: xr.DataArray, span: tuple[float, float]) -> xr.Dataset:
    """Elevation spectra of probes over the time of a record, on the record's frequencies.

    Parameters
    ----------
    probes : Dataset
        As `read_probes` gives it; any rate of its own.
    omega : DataArray, (omega,)
        Frequencies of the record's spectra, rad/s: their step sets the segment.
    span : tuple of float
        First and last time of the record, s.

    Returns
    -------
    Dataset
        ``Ez_probe`` (probe, omega), ``Ez_probes`` (omega), their mean, in m2 s rad-1, with ``dof_probes``,
        ``low_probes``, ``high_probes``, ``valid_probes``.

    Raises
    ------
    CubeError
        If the probes were not recording while the cameras were, for one segment at least, or have uneven
        steps.

    Notes
    -----
    n probes count as n^2 / sum of gamma_ij^2, their squared coherences: those beside one another see the same
    waves. With fewer than four segments they count as one.
    """
    target = omega.values
    duration = 2 * np.pi / float(omega[1] - omega[0])
    time, rate, elevation = _shared_time(probes["time"].values, probes["elevation"].values, span, duration)
    values = np.array([_bridged(row) for row in elevation])
    usable = np.isfinite(values).all(axis=1)
    if not usable.any():
        part = max((_longest_whole(row) for row in values), key=lambda part: part.stop - part.start)
        if part.stop - part.start < 0.9 * duration * rate:
            raise CubeError(
                "every probe has missing values during the record, and none is whole for one segment of "
                f"{duration:.3g} s: repair or leave out the probes"
            )
        warnings.warn(
            f"every probe has missing values during the record: spectra are of {time[part.start]:g} to "
            f"{time[part.stop - 1]:g} s, the longest part without any",
            stacklevel=2,
        )
        values = values[:, part]
        usable = np.isfinite(values).all(axis=1)
    for name, row in zip(probes["probe"].values[~usable], values[~usable]):
        warnings.warn(
            f"probe {name} is left out: {np.isnan(row).sum()} of its {row.size} values during the record are "
            f"missing, more than {LONGEST_GAP} in a row",
            stacklevel=2,
        )
    own, density, count, coherence = _density(values, rate, duration)
    # the frequencies agree where the rates divide; else straight lines between them
    on_grid = np.array([np.interp(target, own, row, right=np.nan) for row in density])
    on_grid[~usable] = np.nan
    independent = _independent(coherence[np.ix_(usable, usable)], count)
    dof = degrees_of_freedom(count) * np.interp(target, own, independent)
    low, high = interval(dof)
    out = xr.Dataset(
        {
            "Ez_probe": (("probe", "omega"), on_grid),
            "Ez_probes": ("omega", np.nanmean(on_grid[usable], axis=0)),
            "dof_probes": ("omega", dof),
            "low_probes": ("omega", low),
            "high_probes": ("omega", high),
            "valid_probes": (
                "omega",
                (np.arange(target.size) >= LOWEST) & np.isfinite(on_grid[usable]).all(axis=0),
            ),
        },
        {name: probes[name] for name in ("probe", "probe_x", "probe_y")} | {"omega": omega},
    )
    return annotate(out, "spectra")


def _bridged(values: Array) -> Array:
    """A series with its short gaps filled by straight lines."""
    missing = ~np.isfinite(values)
    if not missing.any() or missing.all():
        return values
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(int), [0]])))
    out, there = values.copy(), np.flatnonzero(~missing)
    for start, stop in zip(edges[::2], edges[1::2]):
        if stop - start <= LONGEST_GAP:
            out[start:stop] = np.interp(np.arange(start, stop), there, values[there])
    return out


def _longest_whole(values: Array) -> slice:
    """The longest part of a series (n,) without missing values."""
    known = np.concatenate([[0], np.isfinite(values).astype(int), [0]])
    edges = np.flatnonzero(np.diff(known))
    if not edges.size:
        return slice(0, 0)
    starts, stops = edges[::2], edges[1::2]
    k = int(np.argmax(stops - starts))
    return slice(int(starts[k]), int(stops[k]))


def _shared_time(
    time: Array, elevation: Array, span: tuple[float, float], duration: float
) -> tuple[Array, float, Array]:
    """Times during the record, their rate, and elevations (probe, n): missing where the logger paused."""
    inside = (time >= span[0] - 1e-9) & (time <= span[1] + 1e-9)
    if inside.sum() < 8 or time[inside][-1] - time[inside][0] < 0.9 * duration:
        raise CubeError(
            f"the probes cover {time[0]:g} to {time[-1]:g} s, the record {span[0]:g} to {span[1]:g} s:"
            f" they share less than one segment of {duration:.3g} s; check the clock of the probes or"
            " leave them out"
        )
    time, elevation = time[inside], elevation[:, inside]
    steps = np.diff(time)
    rate = float((time.size - 1) / (time[-1] - time[0]))
    step = float(np.median(steps))
    paused = np.flatnonzero(steps > 1.5 * step)
    if paused.size:
        steps_between = np.delete(steps, paused)
        step = float(steps_between.mean())
        rate = 1 / step
        lost = steps[paused] / step - 1
        count = np.maximum(np.rint(lost), 1).astype(int)
        # a pause that is no multiple of the step is not bridged: what follows has other times
        count[np.abs(lost - count) > 0.05] += LONGEST_GAP
        at = np.repeat(paused + 1, count)
        after = np.concatenate([np.arange(1, n + 1) for n in count]) * step
        elevation = np.insert(elevation, at, np.nan, axis=1)
        time, steps = np.insert(time, at, time[at - 1] + after), steps_between
    if np.abs(steps * rate - 1).max() > 0.01:
        raise CubeError("the probes' time steps are unequal: resample them at a fixed rate first")
    return time, rate, elevation


def _independent(coherence: Array, count: int) -> Array:
    """Number of independent probes, (omega,): n^2 / sum of their squared coherences (n, n, omega)."""
    n, lines = coherence.shape[1:]
    if count < MIN_SEGMENTS_FOR_COHERENCE:
        return np.ones(lines)
    coherence = ndimage.uniform_filter1d(coherence, min(COHERENCE_LINES, lines), axis=-1, mode="nearest")
    coherence = ((coherence - 1 / count) / (1 - 1 / count)).clip(0, 1)  # by chance it is 1 / count
    coherence[np.arange(n), np.arange(n)] = 1
    return np.asarray(n**2 / coherence.sum(axis=(0, 1)))


def _density(values: Array, rate: float, duration: float) -> tuple[Array, Array, int, Array]:
    """Frequencies, one-sided density (probe, omega), number of segments, squared coherence of each pair."""
    n = min(round(duration * rate), values.shape[1])
    n -= n % 2
    half, window = n // 2, hann(n)
    count = segment_count(values.shape[1], n)
    ramp = np.arange(n) - (n - 1) / 2
    total = np.zeros((values.shape[0], values.shape[0], n // 2 + 1), complex)
    for s in range(count):
        part = values[:, s * half : s * half + n]
        part = part - part.mean(axis=1, keepdims=True)
        part = part - np.outer(part @ ramp / (ramp @ ramp), ramp)
        lines = fft.rfft(part * window, axis=1)
        total += lines[:, None].conj() * lines
    power = np.einsum("iiw->iw", total).real
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.nan_to_num(np.abs(total) ** 2 / (power[:, None] * power))
    density = power / (count * (window**2).sum() * rate * 2 * np.pi)
    density[:, 1:-1] *= 2
    return 2 * np.pi * np.arange(n // 2 + 1) * rate / n, density, count, coherence


def _group(probes: str | Path | xr.Dataset | None, welch: Welch, cube: xr.Dataset) -> xr.Dataset | None:
    if probes is None:
        return None
    if not isinstance(probes, xr.Dataset):
        probes = read_probes(probes)
    time, runs = cube["time"].values.astype(float), welch.record.runs
    axis = annotate(xr.Dataset(coords=omega_coords(welch.omega)))["omega"].drop_vars("frequency")
    return probe_spectra(probes, axis, (float(time[runs[0][0]]), float(time[runs[-1][1] - 1])))


register(Product("probe_spectra", ("probes", "welch", "cube"), _group, group="spectra"))
