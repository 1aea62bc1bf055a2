"""Degrees of freedom of ring sums.

Waves that stay in a cell longer than a segment lasts correlate segments, and a dispersion relation thinner
than a cell correlates cells. Both are expected from the spectrum and from how fast waves cross the field; the
variance between segments and the correlation of the lines of some nodes correct them.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from wavefield.variables import annotate
from wavefield.water import group_velocity
from wavefield.waves.welch import (
    CORRELATED_CELLS,
    LEAST_COUNT,
    REACH,
    Welch,
    hann,
    hann_power,
    interval,
    richardson_lucy,
)

Array = NDArray[Any]

_NEIGHBOURS = 1.0, 4 / 9, 1 / 36  # squared correlation of lines of a Hann window 0, 1, 2 apart
HANN_LINES = 2 * sum(_NEIGHBOURS) - 1  # lines that count as one


def hann_correlation(lines: int) -> Array:
    """Squared correlation of the lines of a Hann window, (lines, lines), for a flat spectrum."""
    apart = np.abs(np.subtract.outer(np.arange(lines), np.arange(lines)))
    return np.select([apart == n for n in range(len(_NEIGHBOURS))], _NEIGHBOURS, 0.0)


def sum_freedom(power: Array, dof: Array, overlap: Array) -> Array:
    """Degrees of freedom, (n,), of a sum of correlated powers.

    (sum_i P_i)^2 / sum_ij [rho2_ij P_i P_j / sqrt(nu_i nu_j)], with P = power (parts, n), nu = dof (parts, n)
    and rho2 = overlap (parts, parts): the squared correlations of the parts.

    Examples
    --------
    Four parts of ten degrees of freedom each, as strong as each other and independent; then the first alone.

    >>> power = np.array([[1.0, 1.0], [1.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    >>> sum_freedom(power, np.full((4, 2), 10.0), np.eye(4))
    array([40., 10.])
    """
    size = np.sqrt(np.maximum(np.diag(overlap), 1e-300))
    share = power / np.sqrt(dof)
    variance = np.einsum("in,in->n", share, (overlap / np.outer(size, size)) @ share)
    out = np.divide(power.sum(axis=0) ** 2, variance, out=dof.mean(axis=0), where=variance > 0)
    return np.asarray(out)


def with_interval(energy: xr.DataArray, dof: xr.DataArray) -> xr.Dataset:
    """Put a spectrum, its degrees of freedom and its interval together."""
    dof = dof.clip(min=1)
    low, high = (
        xr.apply_ufunc(lambda d, i=i: interval(d)[i], dof, dask="parallelized", output_dtypes=[float])
        for i in (0, 1)
    )
    return annotate(xr.Dataset({"E": energy, "dof": dof, "low": low, "high": high}))


FREQUENCIES_PER_LINE = 2  # waves between the lines too
ROUNDS = 4  # of sharpening; chosen
FLOOR = 1e-12  # of the strongest line


def expected_segment_correlation(power: Array, count: int) -> Array:
    """Variance of a mean over segments relative to independent segments, from their power (n, lines).
    1 + 2 sum_L (1 - L / K) |int S W^2 exp(i omega L T / 2) domega|^2 / (int S W^2 domega)^2, (n, lines).
    """
    lines = np.arange(power.shape[1])
    between = FREQUENCIES_PER_LINE
    fine = np.arange(between * (lines.size - 1) + 1) / between
    response = hann_power(np.arange(-between * REACH, between * REACH + 1) / between)

    def windowed(spectrum: Array) -> Array:
        return np.asarray(ndimage.convolve1d(spectrum, response, axis=1, mode="constant"))

    def spread(ratio: Array) -> Array:
        """Mean of a ratio per line, over the lines that hold a wave."""
        between_lines = np.zeros((len(ratio), fine.size))
        between_lines[:, ::between] = ratio
        return windowed(between_lines)

    every = spread(np.ones((1, lines.size)))
    measured = np.maximum(power, max(FLOOR * float(power.max()), 1e-300))
    # S, sharpened in four rounds, is the spectrum, W^2 the window's power about the line, T the length of a
    # segment; waves that keep their phase for longer than a window resolves correlate segments more
    sharp = richardson_lucy(
        measured,
        np.exp([np.interp(fine, lines, np.log(spectrum)) for spectrum in measured]),
        lambda estimate: windowed(estimate)[:, ::between],
        lambda estimate, ratio: estimate * (spread(ratio) / every),
        ROUNDS,
    )
    total = windowed(sharp)[:, ::between]
    out = np.ones(power.shape)
    for lag in (1, 2):
        shifted = windowed(sharp * np.exp(1j * np.pi * lag * fine))[:, ::between]
        out += 2 * max(1 - lag / count, 0.0) * np.abs(shifted) ** 2 / total**2
    return out


HEADINGS = 32  # of the waves
LAGS = 41  # at which the windows in time and space are joined
LEAST_LEFT = 1e-4  # of a packet's power: what is left after more segments is neglected
NOISE_LINES = 0.75  # of the Nyquist frequency: what is above counts as noise


def hann_autocorrelation(lag: Array) -> Array:
    """Autocorrelation of a Hann window of length 1.

    Examples
    --------
    >>> hann_autocorrelation(np.array([0.0, 0.5, 0.75])).round(3).tolist()
    [1.0, 0.167, 0.008]
    """
    x = np.minimum(np.abs(lag), 1.0)
    return np.asarray(((1 - x) * (2 + np.cos(2 * np.pi * x)) + 1.5 / np.pi * np.sin(2 * np.pi * x)) / 3)


def correlation_at(velocity: Sequence[Array], duration: float, lengths: Sequence[float], count: int) -> Array:
    """Variance of a mean over segments relative to independent ones, for packets at velocities in m/s.
    1 + 2 sum_n (1 - n / K) c(n T / 2)^2 / c(0)^2, with T the duration, s, and the window of lengths in m.
    """
    s = np.linspace(-1, 1, LAGS)
    in_time = hann_autocorrelation(s)
    out, alone = np.ones_like(velocity[0]), np.ones(())
    for lag in range(count):
        apart = (lag / 2 - s) * duration
        in_space = [
            hann_autocorrelation(v[..., None] * apart / length) for v, length in zip(velocity, lengths)
        ]
        # c(dt) = int a(s / T) a(v (dt - s) / L) ds for lines dt apart, a the autocorrelation of the Hann
        # window: a cell holds a packet while it is within the windows in space and in time
        power = (in_space[0] * in_space[1] * in_time).sum(axis=-1) ** 2
        if not lag:
            alone = power
            continue
        out += 2 * (1 - lag / count) * power / alone
        if (power < LEAST_LEFT * alone).all():
            break
    return out


@lru_cache(maxsize=8)
def crossing_correlation(welch: Welch) -> Array:
    """Variance of a mean over segments relative to independent ones, for free waves, (rings,).
    As `correlation_at` for packets with v = c_g + U, averaged over their directions.
    """
    record, table = welch.record, welch.table
    lengths = record.shape[1] * record.dx, record.shape[0] * record.dy
    group = group_velocity(table.k, welch.depth)[:, None]
    heading = np.arange(HEADINGS) * 2 * np.pi / HEADINGS
    velocity = [group * part(heading) + along for part, along in zip((np.cos, np.sin), welch.current)]
    out = correlation_at(velocity, welch.segment * record.dt, lengths, welch.count)
    return np.asarray(out.mean(axis=1))


def wave_share(power: Array) -> Array:
    """Fraction of the powers (rings, lines) that is waves; the highest lines of a ring give its noise."""
    first = int(NOISE_LINES * (power.shape[1] - 1))
    noise = power[:, first:-1].mean(axis=1, keepdims=True) if first < power.shape[1] - 1 else 0.0
    return np.asarray(1 - np.minimum(noise / np.maximum(power, 1e-300), 1.0))


SUM_SIZE = 11  # lines, or rings, where the other axis is summed
MIN_SUM_RATIO = 0.85  # of the variance of a sum to that expected


def accumulate(sums: dict[str, Array], name: str, powers: Array, first: int) -> None:
    """Add the powers (2, rings, lines) of the segment that starts at step ``first``, and keep them."""
    sums[name] += powers
    sums[f"{name} from {first:012d}"] = powers[0].astype(np.float32)


def keep_points(sums: dict[str, Array], name: str, first: Array, second: Array, begin: int) -> None:
    """Hold the Fourier lines (nodes, lines) of some nodes in a segment of two halves, from step ``begin``."""
    series = np.concatenate([first, second], axis=1)
    series = (series - series.mean(axis=1, keepdims=True)) * hann(series.shape[1])
    sums[f"points {name} from {begin:012d}"] = fft.rfft(series, axis=1).astype(np.complex64)


def independent_segments(lines: Array, place: NDArray[np.intp], modes: Array) -> Array:
    """Number of independent segments of each line, (n,), from lines (segments, nodes, n) of some nodes.
    K / (1 + 2 sum_L (1 - L / K) |r_L|^2), r_L the correlation of segments L apart, over the whole record.
    """
    count, size = len(lines), int(place[-1]) + 1
    padded = np.zeros((2 * size, *lines.shape[1:]), complex)
    padded[place] = lines
    there = np.zeros(2 * size)
    there[place] = 1.0
    product = fft.ifft((np.abs(fft.fft(padded, axis=0)) ** 2).sum(axis=1), axis=0)[:size]
    pairs = fft.ifft(np.abs(fft.fft(there)) ** 2)[:size].real.round()
    weight = np.where(pairs > 0, np.arange(size) > 0, False) * 2 * (1 - np.arange(size) / size)
    squares = np.abs(product / np.maximum(pairs, 1)[:, None]) ** 2
    found = count / (1 + (weight[:, None] * squares).sum(axis=0) / np.maximum(squares[0], 1e-300))
    # chance adds 1 / (K - L) / modes to |r|^2, but nothing where a single wave keeps its phase
    return np.asarray(found + 2 * (found - 1) / modes)


def independent_nodes(lines: Array, number: Array) -> Array:
    """Number of independent waves of each line, (n,), from lines (segments, nodes, n) of some nodes.
    (tr C)^2 / |C|^2 of their covariance C, less what chance adds with so many independent segments.
    """
    total = (np.abs(lines) ** 2).sum(axis=(0, 1))
    covariance = np.einsum("spn,sqn->npq", lines.conj(), lines, optimize=True)
    rank = total**2 / np.maximum((np.abs(covariance) ** 2).sum(axis=(1, 2)), 1e-300)
    alike = ((number - rank) / np.maximum(rank * number - 1, 1e-3)).clip(0, 1)
    alike = ndimage.uniform_filter1d(alike, SUM_SIZE, mode="nearest") - 1 / lines.shape[1]
    return np.asarray(1 / alike.clip(1e-6, 1))


def of_products(dof: Mapping[str, Array], power: Array, dof_omega: Array) -> dict[str, Array]:
    """Degrees of freedom of a nonlinear term, from its own and from the waves' E(omega), with its own.
    Its energy goes as the square of the waves', whose relative variance it has four times over.
    """
    total = sum_freedom(power[:, None], dof_omega[:, None], hann_correlation(power.size))
    return {axes: (1 / (1 / own + 4 / total)).clip(1, None) for axes, own in dof.items()}


def ring_freedom(sums: Mapping[str, Any], name: str, welch: Welch) -> dict[str, Array]:
    """Degrees of freedom of E(k, omega), E(omega) and E(k): 2 mean^2 over the variance of the mean.
    Expected from cells (`Welch.freedom`) and correlation (`correlation_of`); of sums corrected by the
    measured variance; at most those of the whole record.
    """
    cells, power = welch.freedom(sums[name]), sums[name][0]
    if welch.count < LEAST_COUNT:
        found = {"both": cells} | freedom_of_sums(power, cells, welch)
        return limited_by_record(found, sums, name, cells, welch)
    independent = cells * (1 + (1 - 1 / welch.count) / 18)  # of segments that are
    starts, powers = _series(sums, name)
    correlation, of_sums = correlation_of(power, welch)
    out = {"both": (independent / correlation).clip(1, None)}
    # correlation of the cells of a sum, in proportion to their share of its variance
    variance = power**2 / independent
    for axis, over in (("omega", 0), ("k", 1)):
        mean = (of_sums * variance).sum(axis=over) / np.maximum(variance.sum(axis=over), 1e-300)
        expected, series = freedom_of_sums(power, independent, welch)[axis], powers.sum(axis=1 + over)
        if axis == "omega" and f"nodes from {starts[0]:012d}" in sums:
            expected, series = dof_of_all_nodes(expected, welch), _series(sums, "nodes")[1]
        out[axis] = _of_sum(series, welch, expected, mean)
    return limited_by_record(out, sums, name, cells, welch)


def limited_by_record(
    dof: dict[str, Array], sums: Mapping[str, Any], name: str, cells: Array, welch: Welch
) -> dict[str, Array]:
    """Degrees of freedom, at most twice the independent segments times the independent waves in each.

    A peak narrower than the lines of the whole record keeps its level from segment to segment: no variance
    between them shows that another record would have another level.
    """
    starts, lines = _series(sums, f"points {name}")
    of_line = dof_of_all_nodes(freedom_of_sums(sums[name][0], cells, welch)["omega"], welch) / welch.dof
    nodes = lines.shape[1]
    number = independent_segments(lines, place_of(starts, welch), 1 / (1 / of_line + 1 / nodes))
    of_cells = (cells / welch.dof * 2 * number).clip(1, None)
    most = {
        "both": of_cells,
        "omega": 2 * number * np.minimum(of_line, independent_nodes(lines, number)),
        "k": freedom_of_sums(sums[name][0], of_cells, welch)["k"],
    }
    return {axis: np.minimum(dof[axis], most[axis]).clip(1, None) for axis in dof}


def dof_of_all_nodes(dof: Array, welch: Welch) -> Array:
    """Degrees of freedom of E(omega) with equal weights of all nodes, from those with the spatial window.
    Waves of a line lie on an arc in the k plane, along which the window correlates `CORRELATED_CELLS` cells.
    """
    arc = np.maximum(dof / welch.dof, 1.0)
    return np.asarray(dof * (1 + (arc - 1) * CORRELATED_CELLS) / arc)


def independent_samples(
    sums: Mapping[str, Any], first: str, second: str, dof_k: tuple[Array, Array], welch: Welch
) -> dict[str, Array]:
    """Independent samples of the cross spectra of two fields, of (k, omega) and of k.

    Without relation between the fields the cross spectrum has a squared modulus of the product of both powers
    over this number: few where both have their energy in the same cells, more where in others. Of the mean
    product of the powers of a cell, 1 / (1 + gamma^2) is the product of their means. Over k half the degrees
    of freedom of both E(k), ``dof_k``, count: what correlates powers correlates products alike.

    A product of waves shares no ridge with them and keeps no phase: only the overlap of half of the windows,
    1 / 6, correlates its segments.
    """
    product = sums[first][0] * sums[second][0]
    power, there = np.sqrt(product), product > 0
    real, imaginary = sums[f"{first}*{second}"]
    coherence = np.divide(real**2 + imaginary**2, product, out=np.zeros_like(power), where=there)
    squares = 2 * sums[f"squares {first}*{second}"] / (1 + coherence)
    cells = np.divide(product, welch.count * squares, out=np.ones_like(power), where=squares > 0).clip(1)
    of_both = (correlation_of(sums[name][0], welch)[0] for name in (first, second))
    correlation = np.sqrt(np.prod([*of_both], axis=0))
    product_of_k = sums[first][0].sum(axis=1) * sums[second][0].sum(axis=1)
    apart = np.divide(
        product_of_k, power.sum(axis=1) ** 2, out=np.ones_like(product_of_k), where=product_of_k > 0
    )
    if "nl" not in (first, second):
        both = welch.count * cells / correlation
        of_k = apart * np.sqrt(dof_k[0] * dof_k[1]) / 2
        return {"both": both.clip(1, None), "k": of_k.clip(1, None)}
    correlation = np.minimum(correlation, 1 + (1 - 1 / welch.count) / 3)
    # of segments that are independent, and of those of a sum in proportion to their share of its variance
    both, of_k = welch.count * cells, apart * freedom_of_sums(power, 2 * welch.count * cells, welch)["k"] / 2
    variance = product / cells
    of_sum = (variance * correlation).sum(axis=1) / np.maximum(variance.sum(axis=1), 1e-300)
    return {"both": (both / correlation).clip(1, None), "k": (of_k / of_sum).clip(1, None)}


def freedom_of_sums(power: Array, dof: Array, welch: Welch) -> dict[str, Array]:
    """Degrees of freedom of sums over k and over omega of powers (rings, lines).
    The ridge of a line is thinner than a ring, so neighbouring rings are correlated as for a flat spectrum.
    """
    overlap, own = welch.table.overlap, np.sqrt(np.diag(welch.table.overlap).clip(1e-300))
    return {
        "omega": sum_freedom(power, dof, np.sqrt(overlap * np.outer(own, own))),
        "k": sum_freedom(power.T, dof.T, hann_correlation(power.shape[1])),
    }


def correlation_of(power: Array, welch: Welch) -> tuple[Array, Array]:
    """Variance of a mean over segments relative to independent ones, for powers (rings, lines) and their
    sums.
    The larger of `expected_segment_correlation` and, for waves, `crossing_correlation`.
    """
    white = 1 + (1 - 1 / welch.count) / 18
    line = expected_segment_correlation(power, welch.count)
    crossing = white + (crossing_correlation(welch)[:, None] - white).clip(0, None) * wave_share(power) ** 2
    return np.maximum(crossing, line), crossing * line / white


def _series(sums: Mapping[str, object], name: str) -> tuple[Array, Array]:
    """First step of each segment, and its powers, (segments, rings, lines)."""
    start = f"{name} from "
    names = sorted(key for key in sums if key.startswith(start))
    steps = np.array([int(key.removeprefix(start)) for key in names])
    series = np.array([sums[key] for key in names])
    return steps, series.astype(np.result_type(series, float))


def _of_sum(powers: Array, welch: Welch, expected: Array, correlation: Array) -> Array:
    """Degrees of freedom of sums (segments, n), given those for independent segments."""
    mean = powers.mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = np.where(mean > 0, powers.var(axis=0) / mean**2, 0.0) / (welch.count - 1)
    between *= (welch.count - 1) / np.maximum(welch.count - correlation, 1.0)  # about the true mean
    ratio = _smooth(between * expected / 2, SUM_SIZE).clip(1e-9 * expected, None)
    single = expected / (welch.count * ratio)  # of one segment's sum
    apart = max(min(SUM_SIZE, expected.size) / HANN_LINES, 1.0)
    number = np.maximum(welch.count / correlation * apart / (1 + 6 / single), LEAST_COUNT)
    student = (number - 1) / (number - 3)  # variance of Student's distribution: the ratio is from few values
    return np.asarray((expected / correlation / (np.maximum(ratio, MIN_SUM_RATIO) * student)).clip(1, None))


def place_of(starts: Array, welch: Welch) -> NDArray[np.intp]:
    """Place of each segment in the record, in halves of a segment."""
    return np.asarray((starts - starts[0]) // welch.half)


def _smooth(values: Array, size: int) -> Array:
    """Mean of the non-zero values in a neighbourhood."""
    valid = values != 0
    weight = ndimage.uniform_filter1d(valid.astype(float), size, mode="nearest")
    mean = ndimage.uniform_filter1d(np.where(valid, values, 0.0), size, mode="nearest")
    return np.where(weight > 1e-9, mean / np.maximum(weight, 1e-9), 1.0)
