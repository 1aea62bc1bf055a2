"""Free waves of a spectrum with frequencies between its lines, and the triads and quartets that they form."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.water import dispersion
from wavefield.waves.estimation.windows import hann_power

Array = NDArray[Any]

FINE = 4  # frequencies to a Fourier line of a segment
MIN_APART = 2  # cells between free waves: nearer ones are one wave under the windows
MIN_DISTANCE = 4  # cells: waves of two pairs that are nearer pair trivially
MIN_CELLS_FROM_ZERO = 2.5  # of the k plane
SHORTEST_WAVES = 0.8  # of the Nyquist wavenumber
MAX_CELLS = 2800  # of the k plane
MAX_LEAKAGE = 0.1  # part of a cell's energy that windows spread from beyond the neighbouring cells
MIN_PEAK_TO_NOISE = 3.0  # energy on the dispersion relation over that off it
RIDGE = 1.5  # lines of a segment: as far from the relation a free wave of the cell may be
CORRELATED_LINES = 1.9  # of a spectrum by Welch's method under a Hann window
# half of the offsets by which two pairs' sums, in cells, may differ: each wave vector is rounded to a cell
OFFSETS = ((0, 1), (1, -1), (1, 0), (1, 1))


@dataclass(frozen=True)
class Waves:
    """Cells of the k plane, and free waves in some of them."""

    n: NDArray[np.int64]  # (cells, 2), rows and columns
    steps: tuple[float, float]  # of ky and kx, rad/m
    relation: Array  # (cells,), frequency of free waves, rad/s
    modes: NDArray[np.int64]  # (modes,), cells that hold free waves
    omega: Array  # (modes,), their frequencies, rad/s
    omega_std: Array  # (modes,)
    width: float  # of a Fourier line of the segments, rad/s
    last: int  # line, of the fine ones, before the highest frequency

    def k(self, cells: Array) -> Array:
        """Wave vectors (..., 2), ky and kx, rad/m."""
        return np.asarray(self.n[cells] * np.array(self.steps))

    def line(self, omega: Array) -> NDArray[np.int64]:
        """Nearest fine lines to frequencies."""
        return np.asarray(np.rint(omega * FINE / self.width), np.int64)

    def rank(self, cells: Array) -> NDArray[np.int64]:
        """Places of cells among the free waves, 0 for the strongest, and for cells without one."""
        rank = np.zeros(len(self.n), np.int64)
        rank[self.modes] = np.arange(self.modes.size)
        return np.asarray(rank[cells])

    def cell(self, n: Array) -> NDArray[np.int64]:
        """Cells at rows and columns (..., 2), -1 where there is none."""
        reach = np.abs(self.n).max(axis=0)
        table = np.full(2 * reach + 1, -1, np.int64)
        table[tuple((self.n + reach).T)] = np.arange(len(self.n))
        inside = (np.abs(n) <= reach).all(axis=-1)
        at = np.where(inside[..., None], n, 0) + reach
        return np.where(inside, table[at[..., 0], at[..., 1]], -1)


@dataclass(frozen=True)
class Groups:
    """Triads or quartets of waves."""

    cells: NDArray[np.int64]  # (groups, 3) or (groups, 4)
    line: NDArray[np.int64]  # the same shape, fine lines whose sums are exact
    omega: Array  # the same shape, frequencies of the free waves, rad/s
    mismatch: Array  # (groups,) rad/s that the last wave is off the frequency of a free one
    mismatch_std: Array  # (groups,)

    def __getitem__(self, chosen: Array | slice) -> "Groups":
        return Groups(*(values[chosen] for values in vars(self).values()))


def free_waves(
    density: xr.DataArray, water: tuple[float, float], current: tuple[float, float], segment: int, dt: float
) -> tuple[Waves, Array]:
    """All free waves of a spectrum, none nearer than two cells to a stronger one, and their energies.
    Water is its depth, m, and surface tension over density, m3/s2.
    """
    ky, kx = (density[name].values.astype(float) for name in ("ky", "kx"))
    steps = float(ky[1] - ky[0]), float(kx[1] - kx[0])
    limit = SHORTEST_WAVES * min(-ky.min(), -kx.min())
    limit = min(limit, np.sqrt(MAX_CELLS * steps[0] * steps[1] / np.pi))
    reach = [int(limit / step) for step in steps]
    n = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach), indexing="ij"), axis=-1).reshape(-1, 2)
    k = np.hypot(*(n * np.array(steps)).T)
    inside = (k > 0) & (k <= limit)
    n, k = n[inside], k[inside]
    vectors = n * np.array(steps)
    relation = dispersion(k, *water) + vectors[:, 0] * current[1] + vectors[:, 1] * current[0]
    width = 2 * np.pi / (segment * dt)
    resolved = (relation > 1.5 * width) & (relation < (segment // 2 - 1.5) * width)
    rows, columns = (np.abs(axis[:, None] - v).argmin(axis=0) for axis, v in zip((ky, kx), vectors.T))
    energy = density.values[:, rows, columns]
    omega = density["omega"].values[:, None]
    off = np.abs(omega - relation)
    noise = np.nanmedian(np.where(off > RIDGE * width, energy, np.nan), axis=0)
    near = np.where(off < RIDGE * width, np.maximum(energy - noise, 0.0), 0.0)
    peak = np.where(off < width, energy, 0.0).sum(axis=0) / np.maximum((off < width).sum(axis=0), 1)
    free = resolved & (k > MIN_CELLS_FROM_ZERO * max(steps)) & (peak > MIN_PEAK_TO_NOISE * noise)
    at = np.flatnonzero(free)
    free[at] = _leakage(density, relation[at] / width, width, rows[at], columns[at]) < MAX_LEAKAGE
    modes: list[int] = []
    taken = np.zeros(len(n), bool)
    for cell in np.argsort(-peak, kind="stable"):
        if free[cell] and not taken[cell]:
            modes.append(int(cell))
            taken |= np.abs(n - n[cell]).max(axis=1) < MIN_APART
    # squares of the energy: what is beside the strongest wave of a cell hardly counts
    weight = (near[:, modes] / near[:, modes].max(axis=0, initial=1e-300)) ** 2
    weight /= weight.sum(axis=0)
    middle = (weight * omega).sum(axis=0)
    variance = CORRELATED_LINES * ((2 * weight * (omega - middle)) ** 2).sum(axis=0)
    found = Waves(
        n, steps, relation, np.array(modes, int), middle, np.sqrt(variance), width, FINE * (segment // 2) - 1
    )
    return found, peak[modes]


def _leakage(density: xr.DataArray, line: Array, width: float, rows: Array, columns: Array) -> Array:
    """Part of the energy at lines of a segment and cells of the k plane that windows spread from afar."""
    energy, omega = density.values, density["omega"].values / width
    out = np.empty(line.size)
    nearest = np.rint(line)
    far = [_spread(n) for n in energy.shape[1:]]
    for value in np.unique(nearest):
        plane = np.tensordot(hann_power(omega - value).astype(energy.dtype), energy, 1)
        for i in np.flatnonzero(nearest == value):
            row, column = (
                spread[n - at : 2 * n - at] for spread, n, at in zip(far, plane.shape, (rows[i], columns[i]))
            )
            near = slice(max(rows[i] - 2, 0), rows[i] + 3), slice(max(columns[i] - 2, 0), columns[i] + 3)
            spread = row @ plane @ column - row[near[0]] @ plane[near] @ column[near[1]]
            out[i] = spread / max(plane[rows[i], columns[i]], 1e-300)
    return out


def _spread(cells: int) -> Array:
    """Energy of a Hann window at distances -cells to cells, over waves anywhere in a cell, (2 cells + 1,)."""
    inside = (np.arange(16) + 0.5) / 16 - 0.5
    return np.asarray(hann_power(np.arange(-cells, cells + 1)[:, None] + inside).mean(axis=1))


def _pairs(waves: Waves) -> dict[tuple[int, int], Array]:
    """Pairs of free waves by the sum of their cells, each (pairs, 2)."""
    i, j = np.triu_indices(waves.modes.size)
    total = waves.n[waves.modes[i]] + waves.n[waves.modes[j]]
    groups: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for key, a, b in zip(map(tuple, total.tolist()), i.tolist(), j.tolist()):
        groups[key].append((a, b))
    return {key: np.array(pairs) for key, pairs in sorted(groups.items())}


def _pairs_of_pairs(waves: Waves) -> Iterator[Array]:
    """Two pairs of free waves with the same sum of wave vectors, (groups, 4)."""
    by_sum = _pairs(waves)
    for (row, column), pairs in by_sum.items():
        p, q = np.triu_indices(len(pairs), 1)
        yield np.concatenate([pairs[p], pairs[q]], axis=1)
        for down, right in OFFSETS:
            others = by_sum.get((row + down, column + right))
            if others is not None:
                p, q = (part.ravel() for part in np.indices((len(pairs), len(others))))
                yield np.concatenate([pairs[p], others[q]], axis=1)


def quartets(waves: Waves, max_mismatch: float) -> Groups:
    """Quartets of free waves, k1 + k2 = k3 + k4 to a cell, up to a mismatch in rad/s."""
    modes = np.concatenate(list(_pairs_of_pairs(waves)))
    omega = waves.omega[modes]
    mismatch = omega @ (1.0, 1.0, -1.0, -1.0)
    n = waves.n[waves.modes[modes]]
    apart = [np.abs(n[:, 0] - n[:, i]).max(axis=1) >= MIN_DISTANCE for i in (2, 3)]
    line = waves.line(omega)
    line[:, 3] = line[:, 0] + line[:, 1] - line[:, 2]
    valid = (np.abs(mismatch) <= max_mismatch) & (line[:, 3] >= FINE) & (line[:, 3] < waves.last)
    valid &= apart[0] & apart[1]
    std = np.sqrt((waves.omega_std[modes] ** 2).sum(axis=1))
    return Groups(waves.modes[modes], line, omega, mismatch, std)[valid]


def triads(waves: Waves) -> Groups:
    """Pairs of free waves and the wave at their sum, k1 + k2 = k3."""
    modes = np.column_stack(np.triu_indices(waves.modes.size))
    third = waves.cell(waves.n[waves.modes[modes]].sum(axis=1))
    omega = np.column_stack([waves.omega[modes], waves.relation[third]])
    line = waves.line(omega)
    line[:, 2] = line[:, 0] + line[:, 1]
    mismatch = omega @ (1.0, 1.0, -1.0)
    std = np.sqrt((waves.omega_std[modes] ** 2).sum(axis=1))
    cells = np.column_stack([waves.modes[modes], third])
    valid = (third >= 0) & (line[:, 2] < waves.last)
    return Groups(cells, line, omega, mismatch, std)[valid]


def quartets_of_pair(waves: Waves, pair: Array) -> Groups:
    """Quartets of two free waves (modes) with every second cell k3 and the cell k4 = k1 + k2 - k3."""
    third = np.flatnonzero((waves.n % 2 == 0).all(axis=1))
    first = np.tile(waves.modes[pair], (third.size, 1))
    fourth = waves.cell(waves.n[first].sum(axis=1) - waves.n[third])
    omega = np.column_stack(
        [np.tile(waves.omega[pair], (third.size, 1)), waves.relation[third], waves.relation[fourth]]
    )
    line = waves.line(omega)
    line[:, 3] = line[:, 0] + line[:, 1] - line[:, 2]
    cells = np.column_stack([first, third, fourth])
    std = np.full(third.size, np.hypot(*waves.omega_std[pair]))
    valid = (fourth >= 0) & ((line >= FINE) & (line < waves.last)).all(axis=1)
    for i in (0, 1):
        valid &= np.abs(waves.n[first[:, i]] - waves.n[third]).max(axis=1) >= MIN_DISTANCE
    return Groups(cells, line, omega, omega @ (1.0, 1.0, -1.0, -1.0), std)[valid]
