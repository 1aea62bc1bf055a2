"""Degrees of freedom of spectra over rings of |k|, and of their sums over k and over omega.

Neighbouring wave vectors are correlated by Hann windows. Segments are correlated by overlap, by waves that
cross the field slowly, and by narrow spectral peaks. Time series at 16 nodes limit the number of independent
segments and waves, for peaks that the whole record does not resolve.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, linalg, ndimage

from wavefield.variables import annotate
from wavefield.water import group_velocity
from wavefield.waves.rings import HANN_CORRELATION
from wavefield.waves.welch import (
    MAIN_LOBE,
    REACH,
    Welch,
    hann,
    hann_power,
    interval,
    overlap_factor,
    richardson_lucy,
)

Array = NDArray[Any]

CORRELATED_CELLS = 2 * sum(HANN_CORRELATION) - 1  # cells along an axis that count as one under a Hann window


def hann_correlation(lines: int) -> Array:
    """Return the squared correlation between frequencies, (lines, lines), of Hann-windowed white noise."""
    first = np.zeros(lines)
    first[: len(HANN_CORRELATION)] = HANN_CORRELATION[:lines]
    return np.asarray(linalg.toeplitz(first))


def sum_freedom(power: Array, dof: Array, overlap: Array) -> Array:
    """Return the degrees of freedom (n,) of sums over the first axis of `power` P (parts, n), which has `dof`
    nu (parts, n): (sum_i P_i)^2 / sum_ij [rho2_ij P_i P_j / sqrt(nu_i nu_j)]. rho2 is the matrix `overlap` of
    squared correlations between parts, scaled to a diagonal of 1."""
    size = np.sqrt(np.maximum(np.diag(overlap), 1e-300))
    share = power / np.sqrt(dof)
    variance = np.einsum("in,in->n", share, (overlap / np.outer(size, size)) @ share)
    out = np.divide(power.sum(axis=0) ** 2, variance, out=dof.mean(axis=0), where=variance > 0)
    return np.asarray(out)


def with_interval(energy: xr.DataArray, dof: xr.DataArray) -> xr.Dataset:
    """Return a Dataset of ``E``, its ``dof`` and factors ``low``, ``high`` from E to its 95 % interval."""
    dof = dof.clip(min=1)
    low, high = (dof.copy(data=limit) for limit in interval(dof.values))
    return annotate(xr.Dataset({"E": energy, "dof": dof, "low": low, "high": high}))


ROUNDS = 4  # of deconvolution; tuned on random seas: with one, intervals of E(omega) hold 2 % less often


def expected_segment_correlation(power: Array, count: int) -> Array:
    """Return the factor (n, frequencies) by which correlation of `count` half-overlapping segments raises the
    variance of their mean. Narrow peaks of the spectra `power` (n, frequencies) raise it."""
    lines = np.arange(power.shape[1])
    between = 2  # frequencies of the sharpened spectrum per line, so that a peak may lie between lines
    fine = np.arange(between * (lines.size - 1) + 1) / between
    response = hann_power(np.arange(-between * REACH, between * REACH + 1) / between)

    def windowed(spectrum: Array) -> Array:
        return np.asarray(ndimage.convolve1d(spectrum, response, axis=1, mode="constant"))

    def spread(ratio: Array) -> Array:
        """Return `ratio` (n, lines), convolved with the Hann response, at twice as many frequencies."""
        between_lines = np.zeros((len(ratio), fine.size))
        between_lines[:, ::between] = ratio
        return windowed(between_lines)

    every = spread(np.ones((1, lines.size)))
    measured = (power / max(float(power.max()), 1e-300)).clip(np.finfo(float).eps)
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


def hann_autocorrelation(lag: Array) -> Array:
    """Return the autocorrelation of a Hann window of length 1 at `lag`, relative to its value at lag zero."""
    x = np.minimum(np.abs(lag), 1.0)
    return np.asarray(((1 - x) * (2 + np.cos(2 * np.pi * x)) + 1.5 / np.pi * np.sin(2 * np.pi * x)) / 3)


def correlation_at(velocity: Sequence[Array], duration: float, lengths: Sequence[float], count: int) -> Array:
    """Return the factor by which correlation raises the variance of a mean over `count` segments, for wave
    packets. It is 1 + 2 sum_n (1 - n / K) c(n T / 2)^2 / c(0)^2 for K segments of `duration` T, s. c is the
    autocorrelation of Hann windows in time and over `lengths` (x, y), m, at packet `velocity` (x, y), m/s."""
    s = np.linspace(-1, 1, 41)  # more points change nothing
    in_time = hann_autocorrelation(s)
    out, alone = np.ones_like(velocity[0]), np.ones(())
    for lag in range(count):
        apart = (lag / 2 - s) * duration
        in_space = [
            hann_autocorrelation(v[..., None] * apart / length) for v, length in zip(velocity, lengths)
        ]
        power = (in_space[0] * in_space[1] * in_time).sum(axis=-1) ** 2
        if not lag:
            alone = power
            continue
        out += 2 * (1 - lag / count) * power / alone
        if (power < np.finfo(float).eps * alone).all():  # all packets have left the window
            break
    return out


@lru_cache(maxsize=8)
def crossing_correlation(welch: Welch) -> Array:
    """Return `correlation_at` for free waves with |k| in each ring, averaged over direction, (rings,)."""
    record, table = welch.record, welch.table
    lengths = record.shape[1] * record.dx, record.shape[0] * record.dy
    group = group_velocity(table.k, welch.depth)[:, None]
    heading = np.arange(32) * 2 * np.pi / 32  # more directions change nothing
    velocity = [group * part(heading) + along for part, along in zip((np.cos, np.sin), welch.current)]
    out = correlation_at(velocity, welch.segment * record.dt, lengths, welch.count)
    return np.asarray(out.mean(axis=1))


def wave_share(power: Array) -> Array:
    """Return the fraction of each value of `power` (rings of |k|, frequencies) that is not white noise."""
    first = int(0.75 * (power.shape[1] - 1))  # above 3/4 of the Nyquist frequency, most power is noise
    noise = power[:, first:-1].mean(axis=1, keepdims=True) if first < power.shape[1] - 1 else 0.0
    return np.asarray(1 - np.minimum(noise / np.maximum(power, 1e-300), 1.0))


def keep_points(sums: dict[str, Array], name: str, first: Array, second: Array, begin: int) -> None:
    """Store in `sums` the Fourier transforms (nodes, frequencies) of a segment at a few nodes. `first` and
    `second` are its halves (nodes, steps). The key names the quantity `name` and the first step `begin`."""
    series = np.concatenate([first, second], axis=1)
    series = (series - series.mean(axis=1, keepdims=True)) * hann(series.shape[1])
    sums[f"points {name} from {begin:012d}"] = fft.rfft(series, axis=1).astype(np.complex64)


def independent_segments(lines: Array, place: NDArray[np.intp], modes: Array) -> Array:
    """Return the number of independent segments at each frequency, (n,), from transforms (segments, nodes,
    n). It is K / (1 + 2 sum_L (1 - L / K) |r_L|^2) for K segments; r_L is the correlation of segments whose
    numbers `place` differ by L. `modes` (n,) independent nodes determine a correction of the bias."""
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
    # |r_L|^2 is biased by 1 / (K - L) / modes, except where a single wave keeps its phase
    return np.asarray(found + 2 * (found - 1) / modes)


def independent_nodes(lines: Array, number: Array) -> Array:
    """Return the number of independent waves at each frequency, (n,): (tr C)^2 / |C|^2, corrected for bias. C
    is the covariance of nodes in `lines` (segments, nodes, n); `number` (n,) counts independent segments."""
    total = (np.abs(lines) ** 2).sum(axis=(0, 1))
    covariance = np.einsum("spn,sqn->npq", lines.conj(), lines, optimize=True)
    rank = total**2 / np.maximum((np.abs(covariance) ** 2).sum(axis=(1, 2)), 1e-300)
    alike = ((number - rank) / np.maximum(rank * number - 1, 1e-3)).clip(0, 1)
    alike = ndimage.uniform_filter1d(alike, 2 * MAIN_LOBE - 1, mode="nearest") - 1 / lines.shape[1]
    return np.asarray(1 / alike.clip(1e-6, 1))


def of_products(dof: Mapping[str, Array], power: Array, dof_omega: Array) -> dict[str, Array]:
    """Return degrees of freedom of spectra of nl = u . grad z, with the keys of `dof`, a first estimate that
    is too high. The spectrum `power` of the waves has `dof_omega` degrees of freedom, both (frequencies,)."""
    total = sum_freedom(power[:, None], dof_omega[:, None], hann_correlation(power.size))
    return {axes: (1 / (1 / own + 4 / total)).clip(1, None) for axes, own in dof.items()}


def ring_freedom(sums: Mapping[str, Any], name: str, welch: Welch) -> dict[str, Array]:
    """Return the degrees of freedom of E(k, omega), key "both", of E(omega), key "omega", and of E(k), key
    "k". They are at most 2 n m for n independent segments and m independent waves, estimated at 16 nodes."""
    power, cells = sums[name][0], welch.freedom(sums[name])
    independent = cells * overlap_factor(welch.count)
    correlation, of_sums = correlation_of(power, welch)
    out = {"both": independent / correlation}
    variance = power**2 / independent
    expected = freedom_of_sums(power, independent, welch)
    for axis, over in (("omega", 0), ("k", 1)):
        # each cell contributes its correlation in proportion to its share of the variance of the sum
        mean = (of_sums * variance).sum(axis=over) / np.maximum(variance.sum(axis=over), 1e-300)
        out[axis] = expected[axis] / mean.clip(1)
    if "nodes" in sums:
        out["omega"] = dof_of_all_nodes(out["omega"], welch)

    starts, lines = _segments(sums, f"points {name}")
    waves = dof_of_all_nodes(freedom_of_sums(power, cells, welch)["omega"], welch) / welch.dof
    number = independent_segments(
        lines, (starts - starts[0]) // welch.half, 1 / (1 / waves + 1 / lines.shape[1])
    )
    waves = np.minimum(waves, independent_nodes(lines, number))
    of_cells = (cells / welch.dof * 2 * number).clip(1, None)
    most = {"both": of_cells, "omega": 2 * number * waves, "k": freedom_of_sums(power, of_cells, welch)["k"]}
    return {axis: np.minimum(out[axis], most[axis]).clip(1, None) for axis in out}


def dof_of_all_nodes(dof: Array, welch: Welch) -> Array:
    """Return the degrees of freedom of E(omega) averaged over all nodes without a spatial window. `dof` are
    the degrees of freedom with a spatial Hann window, which correlates neighbouring wave vectors."""
    arc = np.maximum(dof / welch.dof, 1.0)
    return np.asarray(dof * (1 + (arc - 1) * CORRELATED_CELLS) / arc)


def independent_samples(
    sums: Mapping[str, Any], first: str, second: str, dof_k: tuple[Array, Array], welch: Welch
) -> dict[str, Array]:
    """Return the number N of independent samples of a cross spectrum, key "both", and of its sum over omega,
    key "k". For unrelated fields `first`, `second`: <|S_ab|^2> = E_a E_b / N. `dof_k` is for their E(k)."""
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
    # for independent segments; the correlation of each cell is then weighted by its variance
    both, of_k = welch.count * cells, apart * freedom_of_sums(power, 2 * welch.count * cells, welch)["k"] / 2
    variance = product / cells
    of_sum = (variance * correlation).sum(axis=1) / np.maximum(variance.sum(axis=1), 1e-300)
    return {"both": (both / correlation).clip(1, None), "k": (of_k / of_sum).clip(1, None)}


def freedom_of_sums(power: Array, dof: Array, welch: Welch) -> dict[str, Array]:
    """Return the degrees of freedom of sums of `power` over k, key "omega", and of sums over omega, key "k".
    `power` and its degrees of freedom `dof` are (rings of |k|, frequencies)."""
    overlap, own = welch.table.overlap, np.sqrt(np.diag(welch.table.overlap).clip(1e-300))
    return {
        "omega": sum_freedom(power, dof, np.sqrt(overlap * np.outer(own, own))),
        "k": sum_freedom(power.T, dof.T, hann_correlation(power.shape[1])),
    }


def correlation_of(power: Array, welch: Welch) -> tuple[Array, Array]:
    """Return two factors (rings, frequencies) by which correlated segments raise the variance of `power`. The
    first is for a single value E(k, omega), the second for its contribution to a sum over k or omega."""
    white = overlap_factor(welch.count)
    line = expected_segment_correlation(power, welch.count)
    crossing = white + (crossing_correlation(welch)[:, None] - white).clip(0) * wave_share(power) ** 2
    return np.maximum(crossing, line), crossing * line / white


def _segments(sums: Mapping[str, object], name: str) -> tuple[Array, Array]:
    start = f"{name} from "
    names = sorted(key for key in sums if key.startswith(start))
    return np.array([int(key.removeprefix(start)) for key in names]), np.array(
        [sums[key] for key in names], complex
    )
