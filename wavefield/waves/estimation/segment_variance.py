"""The scatter of ring sums between segments: degrees of freedom that ask nothing of the waves.

Waves that stay in a cell longer than a segment lasts make segments alike, and a ridge thinner than a cell
makes cells alike: both show in how the power of a ring varies from segment to segment, and how long it keeps
its value.
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

_NEAR = 2, 5  # rings and lines to both sides over which scatter is averaged
_WIDE = 21, 11  # rings and lines over which likeness is averaged: it changes from line to line
# segments, of products and of Gaussian waves: with fewer the scatter is averaged over more cells, so that as
# many powers tell it
_MANY = 28, 56
_ALONG = 11  # lines, or rings, where the other axis is summed up
_FURTHEST = 2  # segments apart that may be alike
_TELLING = 8  # segments: fewer do not tell the scatter of Gaussian lines
_ENOUGH = 12  # segments: fewer do not tell how alike they are
_MOST = 4.0  # times as many degrees of freedom as cells and energy let expect, or, of Gaussian lines, as few


def take_in(sums: dict[str, Array], name: str, mine: Array, first: int) -> None:
    """Add a segment's sums, (2, rings, lines), to ``sums``, and keep its power; ``first`` is its step."""
    sums[name] += mine
    sums[f"{name} from {first:012d}"] = mine[0].astype(np.float32)


def keep_lines(power: Array, first: int) -> dict[str, Array]:
    """What `cell_freedom` wants to know of a segment that begins at ``first``, from its power (cells, n)."""
    whole = power.sum(axis=0, dtype=float)
    half = whole.size // 2
    folded = np.concatenate([whole[:1], whole[1:half] + whole[:half:-1], whole[half : half + 1]])
    return {f"f from {first:012d}": folded[None]}


def freedom(sums: Mapping[str, Any], name: str, welch: Welch, gaussian: bool = True) -> dict[str, Array]:
    """Degrees of freedom of E(k, omega), of E(omega) and of E(k).

    Twice the squared mean over the variance of the mean of K segments: c_0 / K times how alike they are, 1 +
    2 sum (1 - L/K) c_L / c_0, c_L their covariance L apart, L to 2, each over what taking off the mean leaves
    of it. The variance is told in parts of what the energy's spread over cells lets expect, which follows the
    ridge: of E(k, omega) `Welch.freedom`, of E(omega) and E(k) `sum_freedom` of that. Of E(k, omega) it is
    averaged over 5 rings and 11 lines (over root (56 / K) times as many where K is less, of products
    (28 / K): as many powers tell it then); likeness over 21 and 11: it is large at the ends of a sea, where
    lines see few frequencies. Of E(omega) and E(k) both are averaged over 11 lines or rings. What is known
    from the scatter alone has its likeness from as near as its variance and is made (n - 1) / (n - 3) larger,
    Student's variance with the n = K / likeness segments that are not alike; of E(omega) and E(k) n is that
    times the independent lines among the 11, over 1 + 6 / nu: powers of nu degrees of freedom tell their
    variance less well than Gaussian values. Fewer than twelve segments are taken to be as alike as
    those of white noise, those of E(omega) and E(k), however many, at least as
    `expected_segment_correlation` has it for
    the spectra of the rings; fewer than eight leave E(k, omega) of Gaussian lines at what is expected.
    """
    theory = welch.freedom(sums[name])
    if welch.count < LEAST_COUNT:
        rings, lines = theory.shape
        return {"both": theory, "omega": np.full(lines, np.nan), "k": np.full(rings, np.nan)}
    starts, powers = _series(sums, name)
    parts, near = np.ones_like(theory), _near(welch.count, _MANY[gaussian])
    if not gaussian:  # their scatter is all that is known
        # products of waves make the cells of a ring rise and fall as one: many times what cells let expect
        parts, segment_correlation = _scatter(powers, starts, welch, theory / 2, (near, near))
        parts = (parts * _student(welch.count / segment_correlation)).clip(1 / _MOST, None)
    elif welch.count >= _TELLING:
        parts = _scatter(powers, starts, welch, theory / 2, (near, _WIDE))[0].clip(1 / _MOST, _MOST)
    power = sums[name][0]
    on_omega = sum_freedom(power, theory, welch.table.overlap)
    on_k = sum_freedom(power.T, theory.T, hann_correlation(power.shape[1]))
    # of the cells of a ring, in proportion to what they bring to the variance of a sum
    alike, variance = expected_segment_correlation(power, welch.count, _FURTHEST), power**2 / theory
    least = [(alike * variance).sum(axis=i) / np.maximum(variance.sum(axis=i), 1e-300) for i in (0, 1)]
    return {
        "both": (theory / parts).clip(1, None),
        "omega": _of_sum(powers.sum(axis=1), starts, welch, on_omega, least[0]),
        "k": _of_sum(powers.sum(axis=2), starts, welch, on_k, least[1]),
    }


def cell_freedom(sums: Mapping[str, Any], name: str, welch: Welch) -> float:
    """Degrees of freedom of a single cell of the strongest lines: twice the segments that are not alike."""
    if welch.count < _ENOUGH:
        return welch.dof
    starts, powers = _series(sums, name)
    lines = powers.sum(axis=1)
    mean = lines.mean(axis=0)
    strong = mean > 1e-2 * mean.max()
    alone, whole = (part[strong].sum() for part in _variances(lines, starts, welch))
    return float(np.clip(2 * welch.count * alone / whole, 2.0, welch.dof)) if whole > 0 else welch.dof


def _series(sums: Mapping[str, Any], name: str) -> tuple[Array, Array]:
    # first steps of the segments, and their powers (segments, rings, lines)
    start = f"{name} from "
    names = sorted(key for key in sums if key.startswith(start))
    steps = np.array([int(key.removeprefix(start)) for key in names])
    return steps, np.array([sums[key] for key in names], float)


def _scatter(
    powers: Array,
    starts: Array,
    welch: Welch,
    scale: Array,
    sizes: tuple[tuple[int, int] | int, ...],
    least: Array | float = 1.0,
) -> tuple[Array, Array]:
    # relative variance of the mean of the segments, times a scale, averaged; and how alike they are
    alone, whole = (part * scale for part in _variances(powers, starts, welch))
    near, wide = sizes
    white = 1 + (1 - 1 / welch.count) / 18
    segment_correlation = np.maximum(np.full(alone.shape, white), least)
    if welch.count >= _ENOUGH:
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.nan_to_num(_smooth(whole, wide) / _smooth(alone, wide), nan=white)
        segment_correlation = np.maximum(found, segment_correlation)
    return np.asarray(_smooth(alone, near) * segment_correlation), segment_correlation


def _student(number: Array) -> Array:
    # Student's variance: how much wider than a normal deviation one is whose variance so many values told
    number = np.maximum(number, LEAST_COUNT)
    return np.asarray((number - 1) / (number - 3))


def _of_sum(powers: Array, starts: Array, welch: Welch, theory: Array, least: Array) -> Array:
    # degrees of freedom of sums (segments, n), from those that their cells let expect
    parts, segment_correlation = _scatter(powers, starts, welch, theory / 2, (_ALONG, _ALONG), least)
    parts = parts.clip(1e-9 * theory, None)
    single = theory * segment_correlation / (welch.count * parts)  # of one segment's sum
    lines = max(min(_ALONG, theory.size) / HANN_LINES, 1.0)
    parts *= _student(welch.count / segment_correlation * lines / (1 + 6 / single))
    return np.asarray((theory / parts).clip(1, None))


def _near(count: int, many: int) -> tuple[int, int]:
    more = max(1.0, np.sqrt(many / count))
    rings, lines = (2 * round(more * half) + 1 for half in _NEAR)
    return rings, lines


def _variances(powers: Array, starts: Array, welch: Welch) -> tuple[Array, Array]:
    # of the mean of the segments over its square, as if none were alike, and as they are
    count = welch.count
    mean = powers.mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where(mean > 0, powers / mean - 1, 0.0)
    place = (starts - starts[0]) // welch.half
    alone = (off**2).mean(axis=0)
    whole, terms = alone, 1.0
    for apart in range(1, min(max(1, count // 4), _FURTHEST) + 1):
        pairs = np.flatnonzero(place[apart:] - place[:-apart] == apart)
        if pairs.size:
            part = 2 * (1 - apart / count)
            whole = whole + part * (off[pairs + apart] * off[pairs]).mean(axis=0)
            terms += part
    return alone / (count - 1), whole / (count - terms)


def _smooth(values: Array, size: int | tuple[int, int]) -> Array:
    known = values != 0
    weight = ndimage.uniform_filter(known.astype(float), size, mode="nearest")
    mean = ndimage.uniform_filter(np.where(known, values, 0.0), size, mode="nearest")
    return np.where(weight > 1e-9, mean / np.maximum(weight, 1e-9), 1.0)


def _cell_dof(sums: Mapping[str, Any], welch: Welch) -> float:
    return cell_freedom(sums, "w", welch)


register(Product("cell_dof", ("ring_sums", "welch"), _cell_dof))
