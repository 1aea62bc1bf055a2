"""Direction and wavenumber of each frequency in time: wavelets in time, phase differences in space."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, wavenumber
from wavefield.waves.estimation.inputs import a_field, takes
from wavefield.waves.estimation.segments import Reader
from wavefield.waves.estimation.wave_record import Record, find_record

Array = NDArray[Any]

CYCLES = 6.0  # omega times the standard deviation of the wavelet's envelope
REACH = 3.5  # standard deviations to either side of the wavelet
LAG = 0.2  # of the wavelength: twice this keeps phases below half a turn, on currents too
TILES = 4  # along each side of the field, for the uncertainty
SPREAD_ERROR = 0.2  # of the spread of directions: few waves at a time are not the mean of their sea
MIN_RESULTANT = 0.7  # of the mean wave vector over the wavenumber: below it there is no one direction
MAX_K_STD = 0.25  # of the wavenumber
TIMES_AT_ONCE = 16


@dataclass(frozen=True)
class _Wavelet:
    """One frequency: kernels at a time and a step later, and nodes from one to the next of a pair."""

    kernels: Array  # (2, steps)
    lags: tuple[int, int]  # along y and x

    @classmethod
    def of(cls, frequency: float, record: Record, depth: float, gamma: float) -> "_Wavelet | None":
        omega = 2 * np.pi * frequency
        length = 2 * np.pi / float(wavenumber(omega, depth, gamma))
        lags = [int(LAG * length / step) for step in (record.dy, record.dx)]
        if min(lags) < 1 or any(n < 4 * lag + 2 * TILES for n, lag in zip(record.shape, lags)):
            return None
        width = CYCLES / omega
        half = int(np.ceil(REACH * width / record.dt))
        t = np.arange(-half, half + 2) * record.dt
        kernels = []
        for shift in (0.0, record.dt):
            # a wave exp(i (k . x - omega t)) is kept, its mirror image is not
            kernels.append(np.exp(1j * omega * (t - shift) - (t - shift) ** 2 / (2 * width**2)))
        norm = np.sqrt(2 * record.dt / (np.abs(kernels[0]) ** 2).sum())
        return cls((norm * np.array(kernels)).astype(np.complex64), (lags[0], lags[1]))

    @property
    def half(self) -> int:
        return int(self.kernels.shape[1]) // 2 - 1


@takes(a_field)
def wavelet_directions(
    field: xr.DataArray,
    frequencies: tuple[float, ...],
    *,
    interval: float | None = None,
    depth: float = np.inf,
    gamma: float = GAMMA,
    record: Record | None = None,
) -> xr.Dataset:
    """Direction and wavenumber of the waves of each frequency in time.

    Parameters
    ----------
    field : DataArray, (time, y, x)
        A variable of a cube, such as z or w; s and m. Computed at once.
    frequencies : tuple of float
        Hz, in the frame of the cameras.
    interval : float, optional
        Time from one result to the next, s; a period of the lowest frequency if not given.
    depth : float
        Depth of the water, m; that of the field, or deep.
    gamma : float
        Surface tension over density, m3/s2. Both set the distance of the nodes that are compared, no more.
    record : Record, optional
        Rectangle and runs; found from the field if not given.

    Returns
    -------
    Dataset
        Over (time, frequency): ``direction`` (rad from x towards y, where the waves go), ``k`` (rad/m) and
        ``local_frequency`` (Hz), that of the waves which the wavelet finds, each with ``_std``;
        ``resultant``, the mean wave vector over k, 1 for a single direction; ``E``, density of the variance
        over Hz.

    Raises
    ------
    CubeError
        If no frequency has a wavelength of five nodes or more that fits the field, or no run holds a wavelet.

    Notes
    -----
    Wavelet directional method (Donelan, Drennan and Magnusson 1996) with all nodes for an array: W(t, f) is
    the transform with a Morlet wavelet, whose envelope has a standard deviation of 6 / (2 pi f). The phase of
    the mean of W* W' of nodes a distance d apart, a fifth and two fifths of a wavelength, is k . d, and the
    loss of its modulus from d to 2 d, along x, y and the diagonals, gives the variance V of the wave vector
    across its mean, to which noise that differs between nodes adds nothing: k^2 = <k>^2 + V. Uncertainties:
    jackknife over 4 x 4 tiles of the field and, of directions, a fifth of their spread sqrt(2 - 2 resultant),
    by which the few waves of a moment differ from their sea. The direction is NaN where several meet
    (resultant below 0.7), k where its error exceeds a quarter of it, all within 21 / (2 pi f) of the ends of
    a run. A wavelet averages over frequencies within 12 %: k is 1 or 2 % above that of their mean.

    References
    ----------
    M. Donelan, W. Drennan and A. Magnusson, J. Phys. Oceanogr. 26 (1996).

    Examples
    --------
    A wave along x, then one along y.

    >>> t, y, x = np.arange(400) * 0.05, np.arange(30) * 0.04, np.arange(40) * 0.04
    >>> early = (t < 10)[:, None, None]
    >>> place = np.where(early, x + 0 * y[:, None], y[:, None] + 0 * x)
    >>> z = 0.01 * np.cos(16.1 * place - 4 * np.pi * t[:, None, None])
    >>> z = xr.DataArray(z, {"time": t, "y": y, "x": x}, ("time", "y", "x"))
    >>> found = wavelet_directions(z, (2.0,)).isel(frequency=0).sel(time=[5.0, 15.0], method="nearest")
    >>> np.degrees(found.direction.values).round().astype(int), found.k.values.round(1)
    (array([ 0, 90]), array([16.1, 16.1]))
    """
    record = find_record(field) if record is None else record
    wavelets = [_Wavelet.of(float(f), record, depth, gamma) for f in frequencies]
    if not any(wavelets):
        given = ", ".join(f"{f:g}" for f in frequencies)
        raise CubeError(
            f"the waves of {given} Hz are shorter than five nodes or longer than the field: choose other"
            " frequencies"
        )
    every = 1 / min(frequencies) if interval is None else interval
    every = max(round(every / record.dt), 1)
    steps = np.concatenate([np.arange(a + every // 2, b, every) for a, b in record.runs])
    out = np.full((len(_NAMES), steps.size, len(wavelets)), np.nan)
    read = Reader([field], record)
    for run in record.runs:
        inside = np.flatnonzero((steps >= run[0]) & (steps < run[1]))
        for part in np.array_split(inside, -(-inside.size // TIMES_AT_ONCE)) if inside.size else ():
            out[:, part] = _measure(read, run, steps[part], wavelets)
    if not np.isfinite(out).any():
        raise CubeError("no run is as long as a wavelet: choose higher frequencies or a longer record")
    at = ("time", "frequency")
    data = {name: (at, values) for name, values in zip(_NAMES, out)}
    coords = {"time": field["time"].values.astype(float)[steps], "frequency": np.asarray(frequencies, float)}
    return annotate(xr.Dataset(data, coords), "wavelets")


_WAYS = (1, 0), (0, 1), (1, 1), (1, -1)  # along y and x, in lags
_NAMES = (
    "direction",
    "k",
    "local_frequency",
    "direction_std",
    "k_std",
    "local_frequency_std",
    "resultant",
    "E",
)


def _measure(read: Reader, run: tuple[int, int], steps: Array, wavelets: list[_Wavelet | None]) -> Array:
    """All of `_NAMES` at some steps of a run, (names, steps, wavelets)."""
    out = np.full((len(_NAMES), steps.size, len(wavelets)), np.nan)
    reach = max(wavelet.half + 1 for wavelet in wavelets if wavelet)
    first, last = max(int(steps[0]) - reach, run[0]), min(int(steps[-1]) + reach + 2, run[1])
    block = read(first, last, run)[0].astype(np.float32)
    flat = (block - block.mean(axis=0)).reshape(last - first, -1)
    for j, wavelet in enumerate(wavelets):
        if wavelet is None:
            continue
        length = wavelet.kernels.shape[1]
        start = steps - wavelet.half - first
        for i in np.flatnonzero((start >= 0) & (start + length <= last - first)):
            lines = wavelet.kernels @ flat[start[i] : start[i] + length]
            planes = lines.reshape(2, *block.shape[1:])
            out[:, i, j] = _of_planes(planes, wavelet.lags, read.record)
    return out


def _tiles(values: Array) -> Array:
    """Sums over the tiles of a plane, (tiles,)."""
    rows = np.linspace(0, values.shape[0], TILES + 1).astype(int)[:-1]
    columns = np.linspace(0, values.shape[1], TILES + 1).astype(int)[:-1]
    return np.asarray(np.add.reduceat(np.add.reduceat(values, rows, 0), columns, 1).ravel())


def _pair(plane: Array, shift: tuple[int, int], margin: tuple[int, int]) -> Array:
    """Sums over tiles, (3, tiles), of the product of nodes a shift apart, and of the powers of both.
    Each node inside the margin is paired with those on both of its sides: all shifts see the same waves.
    """

    def shifted(sign: int) -> Array:
        rows, columns = (
            slice(edge + sign * by, n - edge + sign * by) for n, by, edge in zip(plane.shape, shift, margin)
        )
        return plane[rows, columns]

    before, at, after = (shifted(sign) for sign in (-1, 0, 1))
    power = [np.abs(part) ** 2 for part in (before, at, after)]
    products = np.conj(before) * at + np.conj(at) * after, power[0] + power[1], power[1] + power[2]
    return np.array([_tiles(part) for part in products])


def _pair_in_time(planes: Array, margin: tuple[int, int]) -> Array:
    product = np.conj(planes[0]) * planes[1]
    return _tiles(product[margin[0] : -margin[0], margin[1] : -margin[1]])


def _of_planes(planes: Array, lags: tuple[int, int], record: Record) -> Array:
    """All of `_NAMES` from the transforms (2, ny, nx) at a time and a step later."""
    margin = 2 * lags[0], 2 * lags[1]
    pairs = [_pair(planes[0], (n * i * lags[0], n * j * lags[1]), margin) for i, j in _WAYS for n in (1, 2)]
    in_time = _pair_in_time(planes, margin)
    sums = np.concatenate([*pairs, in_time[None]])  # (25, tiles)
    distances = lags[0] * record.dy, lags[1] * record.dx
    total = sums.sum(axis=1)
    values = _values(total, distances, record.dt)
    number = sums.shape[1]
    without = np.array([_values(total - sums[:, n], distances, record.dt) for n in range(number)])
    off = without - values
    off[:, 0] = (off[:, 0] + np.pi) % (2 * np.pi) - np.pi
    off -= off.mean(axis=0)
    std = np.sqrt((number - 1) / number * (off**2).sum(axis=0))
    std[0] = np.hypot(std[0], SPREAD_ERROR * np.sqrt(max(2 - 2 * values[3], 0.0)))
    power = float((np.abs(planes[0]) ** 2).mean()) * record.dt
    if not values[3] > MIN_RESULTANT:
        values[0] = std[0] = np.nan
    if not std[1] < MAX_K_STD * values[1]:
        values[1] = std[1] = np.nan
    return np.array([*values[:3], *std[:3], values[3], power])


def _values(sums: Array, distances: tuple[float, float], dt: float) -> Array:
    """Direction, k, local frequency and resultant from sums over the field."""
    phases, spreads = [], []
    for near, far in sums[:24].reshape(4, 2, 3):
        coherence = [abs(part[0]) / np.sqrt(part[1].real * part[2].real) for part in (near, far)]
        turn = np.angle(near[0])
        twice = 2 * turn + np.angle(far[0] * np.exp(-2j * turn))
        # at no distance: wave vectors that are distributed askew turn the phase by its third power
        phases.append(float(8 * turn - twice) / 6)
        spreads.append(2 / 3 * float(np.log(coherence[0] / coherence[1])))  # variance of the phase
    ky, kx = phases[0] / distances[0], phases[1] / distances[1]
    mean = max(float(np.hypot(ky, kx)), 1e-9)
    both = (spreads[2] - spreads[3]) / (4 * distances[0] * distances[1])
    along_y, along_x = spreads[0] / distances[0] ** 2, spreads[1] / distances[1] ** 2
    across = (along_y * kx**2 + along_x * ky**2 - 2 * both * kx * ky) / mean**2
    k = float(np.sqrt(mean**2 + max(across, 0.0)))
    frequency = -float(np.angle(sums[24])) / (2 * np.pi * dt)
    return np.array([np.arctan2(ky, kx), k, frequency, mean / k])
