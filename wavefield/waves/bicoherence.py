"""Bicoherence and tricoherence: which waves are bound or exchange energy in threes and fours.

Kernels take Fourier lines Z (frequencies, samples), samples being segments times points.
"""

import numpy as np
import xarray as xr
from scipy import fft, linalg, special

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.waves.cross import significance_level
from wavefield.waves.products import Noted, WaveProduct, register
from wavefield.waves.welch import CHANCE, LEAST_COUNT, MAIN_LOBE, Welch, hann, segment_count

SHARED = 0.1  # of the correlation by chance: pairs whose lines share more are no test of coupling


def fourier_lines(series: np.ndarray, segment: int, count: int) -> np.ndarray:
    """Fourier lines of time series (time, points), (count, segments * points): Hann windows, mean removed."""
    half = segment // 2
    window = hann(segment).astype(series.dtype)[:, None]
    out = []
    for s in range(segment_count(series.shape[0], segment)):
        part = series[s * half : s * half + segment]
        out.append(fft.rfft((part - part.mean(axis=0)) * window, axis=0)[:count])
    return np.ascontiguousarray(np.stack(out, axis=1).reshape(count, -1)).astype(np.complex64)


def bicoherence_of(z: np.ndarray) -> np.ndarray:
    """Bicoherence |<Z1 Z2 Z3*>| / sqrt(<|Z1 Z2|^2> <|Z3|^2>) of lines (n, samples), (n, n).
    Z3 is the line at the sum of the frequencies of Z1 and Z2.
    """
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
    """Squared correlation |<Z1 Z2*>|^2 / (<|Z1|^2> <|Z2|^2>) of lines (n, samples), (n, n)."""
    gram = np.abs(z @ z.conj().T) ** 2
    power = np.maximum(gram.diagonal(), 1e-300)
    return np.asarray(gram / np.sqrt(power[:, None] * power))


def tricoherence_of(z: np.ndarray, shared: np.ndarray, limit: float) -> np.ndarray:
    """Largest tricoherence of each pair of lines with any other pair of the same sum, (n, n).
    Pairs of nearly the same lines are left out: ``shared`` (n, n) is the correlation of every two lines,
    ``limit`` the largest sum of its products.
    """
    n = z.shape[0]
    (herk,) = linalg.get_blas_funcs(("herk",), (z,))
    value = np.full((n, n), np.nan)
    # pairs with the same sum s share one matrix product: A_s A_s^H over the pairs of s
    for s in range(2, 2 * n - 1):
        first = np.arange(max(1, s - n + 1), s // 2 + 1)
        second = s - first
        if first.size < 2:
            continue
        products = z[first] * z[second]
        upper = np.abs(herk(1.0, products.T, trans=2))  # half of the work of a matrix product
        norm = np.sqrt(np.maximum(upper.diagonal(), 1e-300))
        coherence = np.maximum(upper, upper.T) / (norm[:, None] * norm)
        # first <= second and third <= fourth: trivial where the pairs nearly coincide
        trivial = np.abs(first[:, None] - first) <= MAIN_LOBE
        trivial |= (
            shared[np.ix_(first, first)] * shared[np.ix_(second, second)]
            + shared[np.ix_(first, second)] * shared[np.ix_(second, first)]
        ) > limit
        coherence[trivial] = np.nan
        largest = np.fmin(np.fmax.reduce(coherence, axis=1), 1.0)
        value[first, second] = value[second, first] = largest
    return value


def shuffle_phases(z: np.ndarray, points: int, rng: np.random.Generator) -> np.ndarray:
    """Surrogate of lines (n, segments * points): a random phase for each line and segment, at all points."""
    n, samples = z.shape
    phase = np.exp(2j * np.pi * rng.random((n, samples // points))).astype(z.dtype)
    return np.asarray(z * np.repeat(phase, points, axis=1))


HIGHEST_HZ = 5.0  # waves of 6 cm: shorter ones are mostly noise
LINES = 48  # Fourier lines at most, as the work grows with their cube: the segment is shortened to that
SURROGATES = 12  # their mean and scale, widened as Student's distribution is, give levels of 5 % chance
SAMPLES = 4000  # segments times points at most: of more points every second, third ... is taken


def _level_of_one(surrogates: list[np.ndarray]) -> np.ndarray:
    """Level of a coherence whose square without coupling has the mean 1 / N (`significance_level`)."""
    mean = np.mean(np.square(surrogates), axis=0)
    return np.asarray(np.sqrt(significance_level(1 / np.clip(mean, 1e-12, 1 - 1e-9))))


def _level_of_largest(surrogates: list[np.ndarray]) -> np.ndarray:
    """Level of the largest of many coherences, which follows Gumbel's distribution."""
    quantile, count = -np.log(-np.log(1 - CHANCE)), len(surrogates)
    # mean and scale of few surrogates are uncertain: wider as Student's distribution is
    wider = special.stdtrit(count - 1, 1 - CHANCE) / special.ndtri(1 - CHANCE) * np.sqrt(1 + 1 / count)
    scale = np.std(surrogates, axis=0, ddof=1) * np.sqrt(6) / np.pi * wider
    return np.asarray(np.minimum(np.mean(surrogates, axis=0) + (quantile - np.euler_gamma) * scale, 1.0))


def higher_order(series: np.ndarray, dt: float, segment: int) -> xr.Dataset:
    """Bicoherence and tricoherence of time series at some points, with their significance.

    Parameters
    ----------
    series : ndarray, (time, points)
        Elevation or velocity at points so far apart that they are nearly independent.
    dt : float
        Time step, s.
    segment : int
        Steps of a segment.

    Returns
    -------
    Dataset
        ``bicoherence``, ``bicoherence_level``, ``tricoherence``, ``tricoherence_level`` (omega1, omega2);
        ``bicoherence_samples``, number of segments times points.

    Raises
    ------
    CubeError
        If there are fewer than two segments: every phase would then appear coupled.

    Notes
    -----
    Level: what phase-randomised surrogates exceed in 5 % of cases, at each pair of frequencies. The
    surrogates keep the correlation in space, which makes the number of independent samples less than segments
    times points.
    """
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
    # lines beyond the ends of a sea hold what the window spreads of the same strong waves
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
    if welch.count < LEAST_COUNT:
        return Noted(None, ["Bicoherence and tricoherence were left out: they need four segments at least."])
    return higher_order(series, welch.record.dt, welch.segment)


register(WaveProduct("higher_order", ("point_series", "welch"), _group, group="higher_order", cost=1))
