"""Variance of ring sums between segments: degrees of freedom without assumptions on the waves.

Waves that stay in a cell longer than a segment lasts correlate segments, and a dispersion relation thinner
than a cell correlates cells: both show in how the power of a ring varies from segment to segment, and how
long it keeps its value.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.waves.estimation.degrees_of_freedom import HANN_LINES, hann_correlation, sum_freedom
from wavefield.waves.estimation.segment_correlation import expected_segment_correlation
from wavefield.waves.estimation.welch import LEAST_COUNT, Welch
from wavefield.waves.products import Product, register

Array = NDArray[Any]

VARIANCE_REACH = 2, 5  # rings and lines to both sides over which the variance is averaged
CORRELATION_SIZE = (
    21,
    11,
)  # rings and lines over which the correlation is averaged: it changes from line to line
# segments of products and of Gaussian waves: with fewer the variance is averaged over more cells
ENOUGH_FOR_REACH = 28, 56
SUM_SIZE = 11  # lines, or rings, where the other axis is summed
MAX_LAG = 2  # segments that may be correlated
MIN_SEGMENTS_FOR_VARIANCE = 8  # of Gaussian lines
MIN_SEGMENTS_FOR_CORRELATION = 12
MAX_RATIO = (
    4.0  # of degrees of freedom to those expected from cells and energy, or for Gaussian lines its inverse
)


def take_in(sums: dict[str, Array], name: str, powers: Array, first: int) -> None:
    """Add the powers (2, rings, lines) of the segment from step ``first`` to ``sums``, and hold its power."""
    sums[name] += powers
    sums[f"{name} from {first:012d}"] = powers[0].astype(np.float32)


def keep_lines(power: Array, first: int) -> dict[str, Array]:
    """What `cell_freedom` needs of the power (cells, n) of a segment that begins at step ``first``."""
    total = power.sum(axis=0, dtype=float)
    half = total.size // 2
    folded = np.concatenate([total[:1], total[1:half] + total[:half:-1], total[half : half + 1]])
    return {f"f from {first:012d}": folded[None]}


def freedom(
    sums: Mapping[str, np.ndarray], name: str, welch: Welch, gaussian: bool = True
) -> dict[str, Array]:
    """Degrees of freedom of E(k, omega), of E(omega) and of E(k).

    Twice the squared mean over the variance of the mean of K segments: c_0 / K times their correlation, 1 + 2
    sum (1 - L/K) c_L / c_0, c_L their covariance L apart, L to 2, each over what removing the mean leaves of
    it. The variance is expressed in parts of that expected from the energy's distribution over cells, which
    follows the dispersion relation: for E(k, omega) `Welch.freedom`, for E(omega) and E(k) `sum_freedom` of
    that. For E(k, omega) it is averaged over 5 rings and 11 lines (over root (56 / K) times as many if K is
    less, for products (28 / K)), the correlation over 21 and 11: it is large at the ends of a sea, where
    lines hold few frequencies. For E(omega) and E(k) both are averaged over 11 lines or rings.

    What follows from the variance alone has its correlation averaged like its variance and is made (n - 1) /
    (n - 3) larger, Student's variance with n = K / correlation independent segments; for E(omega) and E(k) n
    is that times the independent lines among the 11, over 1 + 6 / nu: powers of nu degrees of freedom
    determine their variance less well than Gaussian values. Fewer than twelve segments are taken to be
    correlated as those of white noise, those of E(omega) and E(k), however many, at least as by
    `expected_segment_correlation` for the spectra of the rings; fewer than eight leave E(k, omega) of
    Gaussian lines as expected.
    """
    expected = welch.freedom(sums[name])
    if welch.count < LEAST_COUNT:
        rings, lines = expected.shape
        return {"both": expected, "omega": np.full(lines, np.nan), "k": np.full(rings, np.nan)}
    starts, powers = _series(sums, name)
    ratio, near = np.ones_like(expected), _variance_size(welch.count, ENOUGH_FOR_REACH[gaussian])
    if not gaussian:
        # products of waves make the cells of a ring rise and fall as one: many times the expected variance
        ratio, correlation = _relative_variance(powers, starts, welch, expected / 2, (near, near))
        ratio = (ratio * _student(welch.count / correlation)).clip(1 / MAX_RATIO, None)
    elif welch.count >= MIN_SEGMENTS_FOR_VARIANCE:
        sizes = near, CORRELATION_SIZE
        ratio = _relative_variance(powers, starts, welch, expected / 2, sizes)[0]
        ratio = ratio.clip(1 / MAX_RATIO, MAX_RATIO)
    power = sums[name][0]
    on_omega = sum_freedom(power, expected, welch.table.overlap)
    on_k = sum_freedom(power.T, expected.T, hann_correlation(power.shape[1]))
    # correlation of the cells of a ring, in proportion to their share of the variance of a sum
    correlation = expected_segment_correlation(power, welch.count, MAX_LAG)
    variance = power**2 / expected
    least = [(correlation * variance).sum(axis=i) / np.maximum(variance.sum(axis=i), 1e-300) for i in (0, 1)]
    return {
        "both": (expected / ratio).clip(1, None),
        "omega": _of_sum(powers.sum(axis=1), starts, welch, on_omega, least[0]),
        "k": _of_sum(powers.sum(axis=2), starts, welch, on_k, least[1]),
    }


def cell_freedom(sums: Mapping[str, object], name: str, welch: Welch) -> float:
    """Degrees of freedom of a single cell of the strongest lines: twice the independent segments."""
    if welch.count < MIN_SEGMENTS_FOR_CORRELATION:
        return welch.dof
    starts, powers = _series(sums, name)
    lines = powers.sum(axis=1)
    mean = lines.mean(axis=0)
    strong = mean > 1e-2 * mean.max()
    independent, actual = (variance[strong].sum() for variance in _variances(lines, starts, welch))
    return float(np.clip(2 * welch.count * independent / actual, 2.0, welch.dof)) if actual > 0 else welch.dof


def _series(sums: Mapping[str, object], name: str) -> tuple[Array, Array]:
    """First steps of the segments, and their powers (segments, rings, lines)."""
    start = f"{name} from "
    names = sorted(key for key in sums if key.startswith(start))
    steps = np.array([int(key.removeprefix(start)) for key in names])
    return steps, np.array([sums[key] for key in names], float)


def _relative_variance(
    powers: Array,
    starts: Array,
    welch: Welch,
    scale: Array,
    sizes: tuple[tuple[int, int] | int, ...],
    least: Array | float = 1.0,
) -> tuple[Array, Array]:
    """Relative variance of the mean of the segments times a scale, averaged, and their correlation."""
    independent, actual = (variance * scale for variance in _variances(powers, starts, welch))
    near, wide = sizes
    white = 1 + (1 - 1 / welch.count) / 18
    correlation = np.maximum(np.full(independent.shape, white), least)
    if welch.count >= MIN_SEGMENTS_FOR_CORRELATION:
        with np.errstate(divide="ignore", invalid="ignore"):
            measured = np.nan_to_num(_smooth(actual, wide) / _smooth(independent, wide), nan=white)
        correlation = np.maximum(measured, correlation)
    return np.asarray(_smooth(independent, near) * correlation), correlation


def _student(number: Array) -> Array:
    """Variance of a deviation scaled by a variance from so many values over that of a normal one."""
    number = np.maximum(number, LEAST_COUNT)
    return np.asarray((number - 1) / (number - 3))


def _of_sum(powers: Array, starts: Array, welch: Welch, expected: Array, least: Array) -> Array:
    """Degrees of freedom of sums (segments, n), from those expected from their cells."""
    sizes = SUM_SIZE, SUM_SIZE
    ratio, correlation = _relative_variance(powers, starts, welch, expected / 2, sizes, least)
    ratio = ratio.clip(1e-9 * expected, None)
    single = expected * correlation / (welch.count * ratio)  # of one segment's sum
    lines = max(min(SUM_SIZE, expected.size) / HANN_LINES, 1.0)
    ratio *= _student(welch.count / correlation * lines / (1 + 6 / single))
    return np.asarray((expected / ratio).clip(1, None))


def _variance_size(count: int, enough: int) -> tuple[int, int]:
    factor = max(1.0, np.sqrt(enough / count))
    rings, lines = (2 * round(factor * reach) + 1 for reach in VARIANCE_REACH)
    return rings, lines


def _variances(powers: Array, starts: Array, welch: Welch) -> tuple[Array, Array]:
    """Variance of the mean of the segments over its square, if they were independent, and as they are."""
    count = welch.count
    mean = powers.mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        deviation = np.where(mean > 0, powers / mean - 1, 0.0)
    place = (starts - starts[0]) // welch.half
    independent = (deviation**2).mean(axis=0)
    actual, terms = independent, 1.0
    for lag in range(1, min(max(1, count // 4), MAX_LAG) + 1):
        pairs = np.flatnonzero(place[lag:] - place[:-lag] == lag)
        if pairs.size:
            weight = 2 * (1 - lag / count)
            actual = actual + weight * (deviation[pairs + lag] * deviation[pairs]).mean(axis=0)
            terms += weight
    return independent / (count - 1), actual / (count - terms)


def _smooth(values: Array, size: int | tuple[int, int]) -> Array:
    """Mean of the values other than zero over a neighbourhood."""
    valid = values != 0
    weight = ndimage.uniform_filter(valid.astype(float), size, mode="nearest")
    mean = ndimage.uniform_filter(np.where(valid, values, 0.0), size, mode="nearest")
    return np.where(weight > 1e-9, mean / np.maximum(weight, 1e-9), 1.0)


def _cell_dof(sums: Mapping[str, object], welch: Welch) -> float:
    return cell_freedom(sums, "w", welch)


register(Product("cell_dof", ("ring_sums", "welch"), _cell_dof))
