"""Wave probes: reading their file, and their spectrum on the frequencies of the cube's."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from wavefield.errors import CubeError, ExperimentError
from wavefield.variables import annotate
from wavefield.waves.welch import LOWEST
from wavefield.waves.windows import degrees_of_freedom, hann, interval, segment_count

Array = NDArray[Any]


def read_probes(path: str | Path) -> xr.Dataset:
    """Read a file of probes.

    Parameters
    ----------
    path : path-like
        CSV with header ``time,<names>`` (s, m), after lines ``# name x y`` that give positions (m).

    Returns
    -------
    Dataset
        ``elevation`` (probe, time), m; coordinates ``probe`` (name), ``probe_x``, ``probe_y`` (m, NaN if not
        given).

    Raises
    ------
    ExperimentError
        If the file cannot be read or its columns do not fit its header.
    """
    path = Path(path)
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        raise ExperimentError(f"cannot read the probes {path}: {error.strerror}") from None
    places = _places(lines)
    names, table = _table(path, [line for line in lines if line.strip() and not line.startswith("#")])
    nowhere = (np.nan, np.nan)
    out = xr.Dataset(
        {"elevation": (("probe", "time"), table[:, 1:].T)},
        {
            "time": ("time", table[:, 0]),
            "probe": ("probe", names),
            "probe_x": ("probe", [places.get(n, nowhere)[0] for n in names]),
            "probe_y": ("probe", [places.get(n, nowhere)[1] for n in names]),
        },
    )
    return annotate(out, "probes")


def _places(lines: list[str]) -> dict[str, tuple[float, float]]:
    # comments of three words whose last two are numbers
    out = {}
    for line in lines:
        words = line.lstrip("#").split()
        if line.startswith("#") and len(words) == 3:
            try:
                out[words[0]] = float(words[1]), float(words[2])
            except ValueError:
                continue  # a remark of three words
    return out


def _table(path: Path, body: list[str]) -> tuple[list[str], Array]:
    header = [word.strip() for word in body[0].split(",")] if body else []
    if len(header) < 2 or header[0] != "time":
        raise ExperimentError(f"the probes {path} have no header 'time,<names>': write one above the numbers")
    try:
        table = np.array([[float(word or "nan") for word in line.split(",")] for line in body[1:]])
    except ValueError as error:
        raise ExperimentError(f"the probes {path} hold something else than numbers: {error}") from None
    if table.ndim != 2 or table.shape[1] != len(header):
        raise ExperimentError(f"the probes {path} do not have {len(header)} numbers in every line")
    return header[1:], table


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
    """
    target = omega.values
    duration = 2 * np.pi / float(omega[1] - omega[0])
    inside, rate = _shared_time(probes["time"].values, span, duration)
    values = probes["elevation"].values[:, inside]
    usable = np.isfinite(values).all(axis=1)
    if not usable.any():
        raise CubeError("every probe has missing values during the record: mend or leave out the probes")
    own, density, count = _density(values, rate, duration)
    # the frequencies agree where the rates divide; else straight lines between them
    on_grid = np.array([np.interp(target, own, row, right=np.nan) for row in density])
    on_grid[~usable] = np.nan
    dof = np.full(target.size, degrees_of_freedom(count) * usable.sum())
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


def _shared_time(time: Array, span: tuple[float, float], duration: float) -> tuple[Array, float]:
    # samples during the record, and their rate
    inside = (time >= span[0] - 1e-9) & (time <= span[1] + 1e-9)
    if inside.sum() < 8 or time[inside][-1] - time[inside][0] < 0.9 * duration:
        raise CubeError(
            f"the probes cover {time[0]:g} to {time[-1]:g} s, the record {span[0]:g} to {span[1]:g} s:"
            f" they share less than one segment of {duration:.3g} s; check the clock of the probes or"
            " leave them out"
        )
    time = time[inside]
    rate = float((time.size - 1) / (time[-1] - time[0]))
    if np.abs(np.diff(time) * rate - 1).max() > 0.01:
        raise CubeError("the probes' time steps are unequal: resample them at a fixed rate first")
    return inside, rate


def _density(values: Array, rate: float, duration: float) -> tuple[Array, Array, int]:
    # frequencies, one-sided density (probe, omega), number of segments
    n = min(round(duration * rate), values.shape[1])
    n -= n % 2
    half, window = n // 2, hann(n)
    count = segment_count(values.shape[1], n)
    ramp = np.arange(n) - (n - 1) / 2
    total = np.zeros((values.shape[0], n // 2 + 1))
    for s in range(count):
        part = values[:, s * half : s * half + n]
        part = part - part.mean(axis=1, keepdims=True)
        part = part - np.outer(part @ ramp / (ramp @ ramp), ramp)
        total += np.abs(fft.rfft(part * window, axis=1)) ** 2
    density = total / (count * (window**2).sum() * rate * 2 * np.pi)
    density[:, 1:-1] *= 2
    return 2 * np.pi * np.arange(n // 2 + 1) * rate / n, density, count
