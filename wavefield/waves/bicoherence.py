"""Bicoherence and tricoherence of time series: phase coupling of three and of four waves.

Bicoherence is |<Z1 Z2 Z3*>| / sqrt(<|Z1 Z2|^2> <|Z3|^2>) with omega3 = omega1 + omega2. Tricoherence is the
largest |<Z1 Z2 Z3* Z4*>| / sqrt(<|Z1 Z2|^2> <|Z3 Z4|^2>) for any omega3 + omega4 = omega1 + omega2. Zi is the
Fourier coefficient at omega_i, and <> the mean over samples (segments and points). The argument `z` (n,
samples) holds the coefficients at the n lowest frequencies.
"""

import numpy as np
import xarray as xr
from scipy import fft, linalg, special

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.waves.cross import significance_level
from wavefield.waves.products import Noted, WaveProduct, register
from wavefield.waves.welch import CHANCE, LEAST_COUNT, MAIN_LOBE, Welch, hann, segment_count

# chosen: frequencies correlated by more than this fraction of the correlation by chance share leakage
SHARED = 0.1


def fourier_lines(series: np.ndarray, segment: int, count: int) -> np.ndarray:
    """Return the `count` lowest Fourier coefficients of each segment and point, (count, segments * points).
    `series` is (time, points). Segments of `segment` steps overlap by half and have a Hann window."""
    half = segment // 2
    window = hann(segment).astype(series.dtype)[:, None]
    out = []
    for s in range(segment_count(series.shape[0], segment)):
        part = series[s * half : s * half + segment]
        out.append(fft.rfft((part - part.mean(axis=0)) * window, axis=0)[:count])
    return np.ascontiguousarray(np.stack(out, axis=1).reshape(count, -1)).astype(np.complex64)


def bicoherence_of(z: np.ndarray) -> np.ndarray:
    """Return the bicoherence of pairs (omega1, omega2), (n, n), from Fourier coefficients `z` (n, samples).
    It is NaN where omega1 or omega2 is zero, or omega1 + omega2 is not one of the n frequencies."""
    n = z.shape[0]
    out = np.full((n, n), np.nan)
    power = (np.abs(z) ** 2).sum(axis=1)
    for i in range(1, n):
        j = np.arange(1, n - i)
        product = z[i] * z[j]
        numerator = np.abs(np.einsum("js,js->j", product, z[i + j].conj()))
        norm = np.sqrt((np.abs(product) ** 2).sum(axis=1) * power[i + j])
        out[i, j] = np.divide(numerator, norm, out=np.zeros(j.size), where=norm > 0)
    return out


def correlations_of(z: np.ndarray) -> np.ndarray:
    """Return squared correlations (n, n) between n frequencies of Fourier coefficients (n, samples)."""
    gram = np.abs(z @ z.conj().T) ** 2
    power = np.maximum(gram.diagonal(), 1e-300)
    return np.asarray(gram / np.sqrt(power[:, None] * power))


def tricoherence_of(z: np.ndarray, shared: np.ndarray, limit: float) -> np.ndarray:
    """Return the largest tricoherence of each pair (omega1, omega2), (n, n), from coefficients `z` (n,
    samples). Sets of four waves are left out if omega3 is nearly omega1, or if spectral leakage alone makes
    them coherent: if products of the correlations `shared` (n, n) between frequencies exceed `limit`."""
    n = z.shape[0]
    (herk,) = linalg.get_blas_funcs(("herk",), (z,))
    value = np.full((n, n), np.nan)
    # one matrix product A A^H for all pairs with the sum s
    for s in range(2, 2 * n - 1):
        first = np.arange(max(1, s - n + 1), s // 2 + 1)
        second = s - first
        if first.size < 2:
            continue
        products = z[first] * z[second]
        upper = np.abs(herk(1.0, products.T, trans=2))  # half of the work of a matrix product
        norm = np.sqrt(np.maximum(upper.diagonal(), 1e-300))
        coherence = np.maximum(upper, upper.T) / (norm[:, None] * norm)
        # pairs of nearly the same lines are coherent without any coupling
        trivial = np.abs(first[:, None] - first) <= MAIN_LOBE
        trivial |= (
            shared[np.ix_(first, first)] * shared[np.ix_(second, second)]
            + shared[np.ix_(first, second)] * shared[np.ix_(second, first)]
        ) > limit
        coherence[trivial] = np.nan
        largest = np.minimum(np.fmax.reduce(coherence, axis=1), 1.0)
        value[first, second] = value[second, first] = largest
    return value


def shuffle_phases(z: np.ndarray, points: int, rng: np.random.Generator) -> np.ndarray:
    """Return Fourier coefficients `z` (n, segments * points) times random phases, which remove phase
    coupling. At a frequency, all `points` of a segment get the same phase, so that they remain correlated."""
    n, samples = z.shape
    phase = np.exp(2j * np.pi * rng.random((n, samples // points))).astype(z.dtype)
    return np.asarray(z * np.repeat(phase, points, axis=1))


HIGHEST_HZ = 5.0  # waves of 6 cm; shorter ones are mostly noise
LINES = 48  # largest number of frequencies, as the cost grows with its cube; segments are shortened to it
SURROGATES = 12  # enough for the mean and scale of a distribution, if Student's t widens the level
SAMPLES = 4000  # largest number of segments times points, for the cost; further points are left out


def _level_of_one(surrogates: list[np.ndarray]) -> np.ndarray:
    """Return the bicoherence of each pair of frequencies, (n, n), that uncoupled waves exceed in 5 % of
    cases. `surrogates` holds the bicoherence (n, n) of several data sets with random phases."""
    mean = np.mean(np.square(surrogates), axis=0)
    return np.asarray(np.sqrt(significance_level(1 / np.clip(mean, 1e-12, 1 - 1e-9))))


def _level_of_largest(surrogates: list[np.ndarray]) -> np.ndarray:
    """Return the tricoherence (n, n) that uncoupled waves exceed in 5 % of cases, from a Gumbel distribution.
    The distribution is fitted to `surrogates`, the tricoherence (n, n) of data sets with random phases."""
    quantile, count = -np.log(-np.log(1 - CHANCE)), len(surrogates)
    # Student's t instead of a normal quantile, because mean and scale are of few surrogates
    wider = special.stdtrit(count - 1, 1 - CHANCE) / special.ndtri(1 - CHANCE) * np.sqrt(1 + 1 / count)
    scale = np.std(surrogates, axis=0, ddof=1) * np.sqrt(6) / np.pi * wider
    return np.asarray(np.minimum(np.mean(surrogates, axis=0) + (quantile - np.euler_gamma) * scale, 1.0))


def higher_order(series: np.ndarray, dt: float, segment: int) -> xr.Dataset:
    """Return bicoherence and tricoherence over (omega1, omega2), rad/s, and levels that uncoupled waves
    exceed in 5 % of cases. `series` is (time, points) with time step `dt`, s. `segment` (steps) is shortened
    if it gives more than 48 frequencies. CubeError if only one segment fits."""
    count = min(segment // 2 + 1, int(HIGHEST_HZ * segment * dt) + 1)
    if count > LINES:
        segment = max(int(segment * LINES / count) // 2 * 2, 16)
        count = min(segment // 2 + 1, int(HIGHEST_HZ * segment * dt) + 1)
    if segment_count(series.shape[0], segment) < 2:
        raise CubeError("higher-order spectra need two segments at least: choose a shorter segment")
    allowed = max(SAMPLES // segment_count(series.shape[0], segment), 1)
    series = series[:, :: -(-series.shape[1] // allowed)]
    z = fourier_lines(series, segment, count)
    rng = np.random.default_rng(0)
    surrogates = [shuffle_phases(z, series.shape[1], rng) for _ in range(SURROGATES)]
    bi = [bicoherence_of(surrogate) for surrogate in surrogates]
    # beyond the ends of a sea, all lines contain leakage of the same strong waves, and are correlated
    chance = np.mean([correlations_of(surrogate) for surrogate in surrogates], axis=0)
    shared = np.sqrt(np.maximum(correlations_of(z) - 2 * chance, 0.0))
    limit = SHARED * np.sqrt(chance[np.triu_indices(count, 1)].mean())
    tri = [tricoherence_of(surrogate, shared, limit) for surrogate in surrogates]
    omega = 2 * np.pi * np.arange(count) / (segment * dt)
    dims = ("omega1", "omega2")
    pairs = {
        "bicoherence": bicoherence_of(z),
        "bicoherence_level": _level_of_one(bi),
        "tricoherence": tricoherence_of(z, shared, limit),
        "tricoherence_level": _level_of_largest(tri),
    }
    out = xr.Dataset(
        {name: (dims, array) for name, array in pairs.items()}, {name: (name, omega) for name in dims}
    )
    out["bicoherence_samples"] = ((), z.shape[1])
    out.attrs = {"segment": segment, "surrogates": SURROGATES}
    return annotate(out, "higher_order")


def _group(series: np.ndarray, welch: Welch) -> xr.Dataset | Noted:
    """Return the bicoherence and tricoherence that `analyze` writes, or a note if there are fewer than four
    segments. `series` (time, points) is the vertical velocity w, m/s, at points about 8 cm apart."""
    if welch.count < LEAST_COUNT:
        return Noted(None, ["Bicoherence and tricoherence were left out: they need four segments at least."])
    return higher_order(series, welch.record.dt, welch.segment)


register(WaveProduct("higher_order", ("point_series", "welch"), _group, group="higher_order", cost=1))
