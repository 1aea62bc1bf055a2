"""Distributions of crest and trough heights, and moments of the elevation with bootstrap uncertainties."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.waves.inputs import a_cube, takes
from wavefield.waves.record import Record, find_record
from wavefield.waves.welch import Reader

Array = NDArray[Any]

POINT_DISTANCE = 0.08  # m between the points of time series: a quarter wavelength at 2.2 Hz
PERIODS_IN_BLOCK = 10.0  # chosen: mean periods in a block, so that blocks are nearly independent
MIN_BLOCKS = 8  # a standard deviation from eight blocks is uncertain by a quarter
BOOTSTRAP_DRAWS = 500  # a standard deviation from 500 draws is uncertain by 3 %
LEVELS = np.arange(0.0, 5.01, 0.25)  # in standard deviations; one wave in 270,000 exceeds 5


def extremes(series: Array) -> tuple[Array, Array, Array]:
    """Return three arrays (waves,): first step, crest height and trough depth (> 0) of each wave. A wave lies
    between two zero up-crossings of `series` (time,). Parabolas refine crests and troughs."""
    start = np.flatnonzero((series[:-1] < 0) & (series[1:] >= 0))
    if start.size < 2:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
    heights = []
    for sign in (1, -1):
        values = sign * series
        peaks = values.copy()
        a, b, c = values[:-2], values[1:-1], values[2:]
        curvature = a - 2 * b + c
        top = (b >= a) & (b >= c) & (curvature < 0)
        peaks[1:-1] = np.where(top, b - (a - c) ** 2 / (8 * np.where(top, curvature, -1.0)), b)
        heights.append(np.maximum.reduceat(peaks, start + 1)[:-1])
    return start[:-1], heights[0], heights[1]


def distant_nodes(block: Array, record: Record) -> Array:
    """Return the values (steps, nodes) of `block` (steps, ny, nx) at nodes about 8 cm apart."""
    apart_y, apart_x = (max(1, round(POINT_DISTANCE / step)) for step in (record.dy, record.dx))
    return block[:, ::apart_y, ::apart_x].reshape(len(block), -1)


def _series(field: xr.DataArray, record: Record) -> list[Array]:
    read = Reader([field], record)
    return [
        np.concatenate([distant_nodes(block, record).astype(float) for (block,) in read.blocks(run)])
        for run in record.runs
    ]


def _by_block(runs: list[Array], block: int, sigma: float) -> tuple[Array, Array, Array]:
    """Return three arrays for blocks of `block` steps: sums of z^0 to z^4 (blocks, 5); numbers of crests
    above each level (blocks, levels); numbers of troughs deeper than each level (blocks, levels). Each of
    `runs` is z (time, points), m. Levels are `LEVELS` times `sigma`, m."""
    sums, above = [], []
    for run in runs:
        count = run.shape[0] // block
        for i in range(count):
            part = run[i * block : (i + 1) * block]
            sums.append([float((part**p).sum()) for p in range(5)])
        counts = np.zeros((2, count, LEVELS.size))
        for series in run.T:
            start, crest, trough = extremes(series)
            number = start // block
            inside = number < count
            for kind, values in enumerate((crest, trough)):
                np.add.at(counts[kind], number[inside], values[inside, None] >= sigma * LEVELS)
        above.append(counts)
    return np.array(sums).reshape(-1, 5), *np.concatenate(above, axis=1)


def _moments(sums: Array) -> Array:
    """Return significant height, skewness, excess kurtosis (..., 3) from sums of z^0 to z^4 (..., 5)."""
    mean, m2, m3, m4 = (sums[..., p] / sums[..., 0] for p in (1, 2, 3, 4))
    variance = m2 - mean**2
    third = m3 - 3 * mean * m2 + 2 * mean**3
    fourth = m4 - 4 * mean * m3 + 6 * mean**2 * m2 - 3 * mean**4
    return np.stack([4 * np.sqrt(variance), third / variance**1.5, fourth / variance**2 - 3], axis=-1)


def tayfun(level: Array, skewness: float) -> Array:
    """Return the probability that a crest in a second-order sea exceeds each `level` (Tayfun 1980).
    `level` is in standard deviations of z. A `skewness` of zero or less gives Rayleigh's distribution."""
    steepness = max(float(skewness), 0.0) / 3
    level = np.asarray(level, float)
    if steepness < 1e-6:
        return np.asarray(np.exp(-(level**2) / 2))
    return np.asarray(np.exp(-((np.sqrt(1 + 2 * steepness * level) - 1) ** 2) / (2 * steepness**2)))


@takes(a_cube)
def crest_statistics(cube: xr.Dataset) -> xr.Dataset:
    """Distributions of crest and trough heights; Hs, skewness and kurtosis with standard uncertainties.

    Parameters
    ----------
    cube : Dataset
        With the elevation z (m) over (time, y, x). A cube on disk is read in pieces.

    Returns
    -------
    Dataset
        ``significant_height`` (m), ``skewness`` (1), ``kurtosis`` (excess, 1) and their standard
        uncertainties ``_std``; ``mean_period`` (s) between zero up-crossings; ``waves``, the number of waves
        at all points. Over ``level``, 0 to 5 standard deviations of z: ``crest_exceedance`` and
        ``trough_exceedance``, the fractions of crests and troughs that reach the level, and their ``_std``;
        ``rayleigh`` and ``tayfun``, the fractions that these distributions predict.

    Raises
    ------
    CubeError
        If the cube has no z, or fewer than 8 x 8 nodes or 80 mean periods are measured.

    Notes
    -----
    Elevations are taken at nodes about 8 cm apart and refer to the mean in time of each node. Uncertainties
    are from a bootstrap over blocks of ten mean periods. Tayfun: J. Geophys. Res. 85 (1980) 1548.

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.crest_statistics(wf.open_cube("sea.zarr"))
    >>> print(f"{float(found.mean_period):.1f} s")
    0.5 s
    """
    field = validate(cube, "z")["z"]
    record = find_record(field)
    runs = _series(field, record)
    mean = np.concatenate(runs).mean(axis=0)
    runs = [run - mean for run in runs]
    crossings = sum(float(((run[:-1] < 0) & (run[1:] >= 0)).sum()) for run in runs)
    steps = record.steps_in_runs()
    period = steps * mean.size / max(crossings, 1.0)
    block = max(int(np.ceil(PERIODS_IN_BLOCK * period)), 2)
    if sum(run.shape[0] // block for run in runs) < MIN_BLOCKS:
        raise CubeError(
            f"the record of {steps} steps holds fewer than {MIN_BLOCKS} blocks of ten waves ({block} steps):"
            " errors of its moments cannot be estimated"
        )
    sigma = float(np.sqrt(np.mean(np.concatenate(runs) ** 2)))
    sums, crests, troughs = _by_block(runs, block, sigma)
    drawn = np.random.default_rng(0).integers(0, len(sums), (BOOTSTRAP_DRAWS, len(sums)))
    moments = _moments(sums.sum(axis=0))
    errors = _moments(sums[drawn].sum(axis=1)).std(axis=0, ddof=1)
    out: dict[str, Any] = {}
    for name, value, std in zip(("significant_height", "skewness", "kurtosis"), moments, errors):
        out[name], out[f"{name}_std"] = ((), value), ((), std)
    for name, above in (("crest", crests), ("trough", troughs)):
        total = above.sum(axis=0)
        resampled = above[drawn].sum(axis=1)
        out[f"{name}_exceedance"] = ("level", total / total[0])
        out[f"{name}_exceedance_std"] = ("level", (resampled / resampled[:, :1]).std(axis=0, ddof=1))
    out |= {
        "rayleigh": ("level", np.exp(-(LEVELS**2) / 2)),
        "tayfun": ("level", tayfun(LEVELS, moments[1])),
        "mean_period": ((), period * record.dt),
        "waves": ((), crests[:, 0].sum()),
    }
    return annotate(xr.Dataset(out, {"level": LEVELS}, {"blocks": len(sums)}), "crests")
