"""Three- and four-wave coherence of wave vectors: which triads and quartets exchange energy or force others.

Fourier lines X (cells, segments, lines) are amplitudes of exp(i (k . x - omega t)) on a lattice of k.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, stats

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import GAMMA, dispersion
from wavefield.waves.dispersion_relation.current_used import CurrentUsed
from wavefield.waves.estimation.inputs import a_field, takes
from wavefield.waves.estimation.segments import Reader, spatial_window
from wavefield.waves.estimation.surrogate_probability import probabilities
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.estimation.windows import hann
from wavefield.waves.products import Product, register
from wavefield.waves.spectra.field_spectra import spectrum

Array = NDArray[Any]

CELL_STRIDE = 2  # of the lattice: neighbouring cells are correlated by the Hann window
MIN_DISTANCE = 2  # of the lattice: nearer wave vectors are one wave under the windows, and pair trivially
MIN_CELLS_FROM_ZERO = 2.5  # of the k plane
SHORTEST_WAVES = 0.8  # of the Nyquist wavenumber
MAX_CELLS = 700  # wave vectors of the lattice
MIN_PEAK_TO_NOISE = 3.0  # energy on the dispersion relation over that off it
MIN_SEGMENTS = 8
MAX_LAG = 24  # segments over which lines may be autocorrelated
TESTS_AT_A_TIME, STEPS_AT_A_TIME = 2048, 256
LEAST_NULL = 50  # scores of surrogates: fewer give no probabilities


@dataclass(frozen=True)
class ResonanceSettings:
    """Segments, wave vectors and significance of the coherences.

    Parameters
    ----------
    segment : int
        Steps of a segment: short ones give the samples that a small coherence needs.
    modes : int
        At most so many wave vectors of free waves, the strongest.
    mismatch : int
        Quartets are tested up to so many lines off resonance.
    surrogates : int
        Phase-randomised copies of the record.
    false_discovery : float
        Fraction of false ones among the triads, and among the quartets, that are called significant.
    listed : int
        At most so many are listed, the least probable first.
    """

    segment: int = 64
    modes: int = 100
    mismatch: int = 4
    surrogates: int = 6
    false_discovery: float = 0.02
    listed: int = 200


@dataclass(frozen=True)
class _Lattice:
    """Wave vectors on every second cell, with the line of the dispersion relation at each."""

    n: NDArray[np.int64]  # (cells, 2), rows and columns, in units of two cells
    steps: tuple[float, float]  # of ky and kx, rad/m
    line: NDArray[np.int64]  # (cells,), of the relation; 0 where it is beyond the spectrum
    free: NDArray[np.int64]  # cells that hold free waves
    cell: dict[tuple[int, int], int]

    def k(self, cells: Array) -> Array:
        return np.asarray(self.n[cells] * np.array(self.steps))

    def distinct(self, a: Array, b: Array) -> Array:
        """Whether the windows resolve the wave vectors of cells a and b."""
        return np.asarray(np.abs(self.n[a] - self.n[b]).max(axis=-1) >= MIN_DISTANCE)


def _lattice(
    density: xr.DataArray,
    water: tuple[float, float],
    current: tuple[float, float],
    dt: float,
    settings: ResonanceSettings,
) -> _Lattice:
    """The lattice of a spectrum; water is its depth, m, and surface tension over density, m3/s2."""
    ky, kx = (density[name].values.astype(float) for name in ("ky", "kx"))
    steps = CELL_STRIDE * float(ky[1] - ky[0]), CELL_STRIDE * float(kx[1] - kx[0])
    limit = SHORTEST_WAVES * min(-ky.min(), -kx.min())
    limit = min(limit, np.sqrt(MAX_CELLS * steps[0] * steps[1] / np.pi))
    reach = [int(limit / step) for step in steps]
    n = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach), indexing="ij"), axis=-1).reshape(-1, 2)
    k = np.hypot(*(n * np.array(steps)).T)
    inside = (k > 0) & (k <= limit)
    n, k = n[inside], k[inside]
    vectors = n * np.array(steps)
    omega = dispersion(k, *water) + vectors[:, 0] * current[1] + vectors[:, 1] * current[0]
    width = 2 * np.pi / (settings.segment * dt)
    line = np.rint(omega / width).astype(np.int64)
    resolved = (line >= 2) & (line < settings.segment // 2 - 1)
    # energy on the relation over that one and a half lines off it and further
    rows, columns = (np.abs(axis[:, None] - v).argmin(axis=0) for axis, v in zip((ky, kx), vectors.T))
    energy = density.values[:, rows, columns]
    off = np.abs(density["omega"].values[:, None] - omega)
    peak = np.where(off < width, energy, 0.0).sum(axis=0) / np.maximum((off < width).sum(axis=0), 1)
    noise = np.nanmedian(np.where(off > 1.5 * width, energy, np.nan), axis=0)
    free = (
        resolved & (k > MIN_CELLS_FROM_ZERO * max(steps) / CELL_STRIDE) & (peak > MIN_PEAK_TO_NOISE * noise)
    )
    cells = np.flatnonzero(free)
    cells = np.sort(cells[np.argsort(-peak[cells], kind="stable")][: settings.modes])
    number = {(int(a), int(b)): i for i, (a, b) in enumerate(n)}
    return _Lattice(n, steps, np.where(resolved, line, 0), cells, number)


def _amplitudes(field: xr.DataArray, record: Record, lattice: _Lattice) -> list[Array]:
    """Transforms in space at the wave vectors of the lattice, (cells, steps) of each run."""
    ny, nx = record.shape
    window = spatial_window(ny, nx).astype(np.float32)
    row, column = (CELL_STRIDE * lattice.n).T
    mirrored = column < 0  # F(-k) = F(k)* of a real field
    row, column = np.where(mirrored, -row, row) % ny, np.abs(column)
    read = Reader([field], record)
    out = []
    for run in record.runs:
        parts = []
        for (block,) in read.blocks(run, STEPS_AT_A_TIME):
            along_x = fft.rfft(block * window, axis=2)[:, :, : column.max() + 1]
            transform = fft.fft(along_x, axis=1)[:, row, column]
            parts.append(np.where(mirrored, transform.conj(), transform).T.astype(np.complex64))
        out.append(np.concatenate(parts, axis=1))
    return out


def _segment_lines(runs: list[Array], segment: int) -> Array:
    """Fourier lines of amplitudes (cells, steps) in time, over their rms: (cells, segments, segment // 2)."""
    half, window = segment // 2, hann(segment).astype(np.float32)
    lines = []
    for run in runs:
        for a in range(0, run.shape[1] - segment + 1, half):
            part = run[:, a : a + segment]
            part = (part - part.mean(axis=1, keepdims=True)) * window
            lines.append(fft.ifft(part, axis=1)[:, : segment // 2])
    if len(lines) < MIN_SEGMENTS:
        raise CubeError(
            f"the record holds {len(lines)} segments of {segment} steps: coherences of wave vectors need"
            f" {MIN_SEGMENTS}"
        )
    x = np.stack(lines, axis=1)
    # coherences do not depend on the scale; products of four in single precision do
    rms = np.sqrt((np.abs(x) ** 2).mean(axis=1, dtype=np.float64, keepdims=True))
    return np.asarray(np.divide(x, rms, out=np.zeros_like(x), where=rms > 0), np.complex64)


def _surrogates(lines: Array, count: int, rng: np.random.Generator) -> Iterator[Array]:
    """Copies of lines with random phases of each line's spectrum over the record.

    They have the power and autocorrelation of each line and no relation between lines.
    """
    spectra = fft.fft(lines, axis=1)
    turn = np.empty_like(spectra)
    for _ in range(count):
        angle = rng.random(spectra.shape, dtype=np.float32) * np.float32(2 * np.pi)
        np.cos(angle, out=turn.real)
        np.sin(angle, out=turn.imag)
        turn *= spectra
        yield np.asarray(fft.ifft(turn, axis=1))


def _autocorrelation(lines: Array) -> Array:
    """Autocorrelation of lines (cells, segments, lines) at lags from 1 on, (cells, lines, lags)."""
    count = lines.shape[1]
    lags = min(MAX_LAG, count // 4)
    power = np.abs(fft.fft(lines, n=2 * count, axis=1)) ** 2
    correlation = fft.ifft(power, axis=1)[:, : lags + 1]
    return np.asarray(np.moveaxis(correlation[:, 1:] / np.maximum(correlation[:, :1].real, 1e-300), 1, 2))


@dataclass(frozen=True)
class _Groups:
    """Triads or quartets of waves."""

    cells: NDArray[np.int64]  # (groups, 3) or (groups, 4)
    line: NDArray[np.int64]  # the same shape
    mismatch: NDArray[np.int64]  # (groups,) lines that the last wave is off the relation

    def __getitem__(self, chosen: Array) -> "_Groups":
        return _Groups(self.cells[chosen], self.line[chosen], self.mismatch[chosen])


@dataclass(frozen=True)
class _Coherences:
    """Coherences of triads or quartets, each (groups,)."""

    squared: Array
    score: Array  # |sum|^2 over its mean by chance
    samples: Array  # independent ones

    def __getitem__(self, chosen: Array) -> "_Coherences":
        return _Coherences(self.squared[chosen], self.score[chosen], self.samples[chosen])


def _pairs(lattice: _Lattice) -> dict[tuple[int, int], Array]:
    """Pairs of free waves by the sum of their wave vectors, each (pairs, 2)."""
    i, j = np.triu_indices(lattice.free.size)
    first, second = lattice.free[i], lattice.free[j]
    total = lattice.n[first] + lattice.n[second]
    groups: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for key, a, b in zip(map(tuple, total.tolist()), first.tolist(), second.tolist()):
        groups[key].append((a, b))
    return {key: np.array(pairs) for key, pairs in sorted(groups.items())}


def _quartets(lattice: _Lattice, lines: int, max_mismatch: int) -> _Groups:
    parts = []
    for pairs in _pairs(lattice).values():
        p, q = np.triu_indices(len(pairs), 1)
        parts.append(np.concatenate([pairs[p], pairs[q]], axis=1))
    cells = np.concatenate(parts)
    first, _, third, fourth = cells.T
    cells = cells[lattice.distinct(first, third) & lattice.distinct(first, fourth)]
    line = lattice.line[cells]
    mismatch = line[:, 0] + line[:, 1] - line[:, 2] - line[:, 3]
    line[:, 3] += mismatch
    valid = (np.abs(mismatch) <= max_mismatch) & (line[:, 3] >= 1) & (line[:, 3] < lines)
    return _Groups(cells[valid], line[valid], mismatch[valid])


def _triads(lattice: _Lattice, lines: int) -> _Groups:
    parts = [
        np.column_stack([pairs, np.full(len(pairs), lattice.cell[total])])
        for total, pairs in _pairs(lattice).items()
        if total in lattice.cell and lattice.line[lattice.cell[total]]
    ]
    cells = np.concatenate(parts) if parts else np.zeros((0, 3), np.int64)
    line = lattice.line[cells]
    mismatch = line[:, 0] + line[:, 1] - line[:, 2]
    line[:, 2] += mismatch
    valid = line[:, 2] < lines
    return _Groups(cells[valid], line[valid], mismatch[valid])


def _coherences(x: Array, autocorrelation: Array, groups: _Groups) -> _Coherences:
    parts = []
    for a in range(0, len(groups.cells), TESTS_AT_A_TIME):
        some = slice(a, a + TESTS_AT_A_TIME)
        places = list(zip(groups.cells[some].T, groups.line[some].T))
        waves = [x[cell, :, line] for cell, line in places]
        memory = [autocorrelation[cell, line] for cell, line in places]
        one, other = waves[0] * waves[1], waves[2]
        memory_of_other = memory[2]
        if len(waves) == 4:
            other, memory_of_other = waves[2] * waves[3], memory[2] * memory[3]
        # products with a long autocorrelation have fewer independent samples
        correlated = 1 + 2 * (memory[0] * memory[1] * memory_of_other.conj()).sum(axis=1).real
        cross = np.abs((one * other.conj()).sum(axis=1)) ** 2
        powers = np.abs(one) ** 2, np.abs(other) ** 2
        norm = np.maximum(powers[0].sum(axis=1) * powers[1].sum(axis=1), 1e-300)
        chance = np.maximum((powers[0] * powers[1]).sum(axis=1) * np.maximum(correlated, 1.0), 1e-300)
        parts.append(np.stack([cross / norm, cross / chance, norm / chance]))
    return _Coherences(*(np.concatenate(parts, axis=1) if parts else np.zeros((3, 0))))


@takes(a_field)
def resonances(
    field: xr.DataArray,
    depth: float = np.inf,
    *,
    gamma: float = GAMMA,
    current: tuple[float, float] = (0.0, 0.0),
    density: xr.DataArray | None = None,
    record: Record | None = None,
    settings: ResonanceSettings | None = None,
) -> xr.Dataset:
    """Triads and quartets of wave vectors whose phases are coupled, on resonance and off it.

    Parameters
    ----------
    field : DataArray, (time, y, x)
        Best w of a cube, or z. Read once, in pieces; computed at once.
    depth : float
        Depth of the water, m.
    gamma : float
        Surface tension over density, m3/s2.
    current : tuple of float
        Along x and y, m/s (`fit_dispersion`).
    density : DataArray, (omega, ky, kx), optional
        Its spectrum, from which free waves are selected; computed if not given.
    record : Record, optional
        Rectangle and runs; found from the field if not given.
    settings : ResonanceSettings, optional
        Segments, number of wave vectors, rate of false discoveries.

    Returns
    -------
    Dataset
        The least probable ``quartet``: wave vectors ``quartet_kx``, ``quartet_ky`` and ``quartet_omega``
        (quartet, wave), k1 + k2 = k3 + k4; ``quartet_coherence``, its ``_std``, ``quartet_probability``,
        ``quartet_significant``, ``quartet_mismatch``, rad/s by which the fourth wave is off the relation.
        The same for ``triad``, k1 + k2 = k3. Over ``mismatch``: ``coherence_excess``, the mean over all
        quartets of the squared coherence less what the surrogates give, its ``_std``, and ``quartets``, how
        many. Also ``quartet_tests``, ``triad_tests``, ``modes``, ``samples``.

    Raises
    ------
    CubeError
        If the record is too short or fewer than four wave vectors hold free waves.

    Notes
    -----
    Squared coherence |<a1 a2 a3* a4*>|^2 / (<|a1 a2|^2> <|a3 a4|^2>), and |<a1 a2 a3*>|^2 / (<|a1 a2|^2>
    <|a3|^2>), within [0, 1]; a are lines of Hann-windowed segments at wave vectors on every second cell of
    the k plane, each at the line nearest to the dispersion relation but for the last, whose line makes the
    sum of frequencies exact: within a line of the relation it is a resonance, further off a forced wave.
    Pairs that the windows do not resolve are left out. Probabilities are those of records whose lines have
    the same spectra and random phases, pooled over all quartets after division by their own correlation;
    discoveries are controlled over all tests (Benjamini and Hochberg 1995). See Aubourg and Mordant 2015
    (arXiv 1503.04110), Campagne et al. 2019 (arXiv 1906.06385). With N samples a single squared coherence is
    determined to 1 / N: smaller ones show in ``coherence_excess``.

    Examples
    --------
    Two hundred waves of independent phases.

    >>> rng = np.random.default_rng(0)
    >>> k, angle = rng.uniform(15, 45, 200), rng.uniform(-np.pi, np.pi, 200)
    >>> kx, ky = k * np.cos(angle), k * np.sin(angle)
    >>> t, y, x = np.arange(512) * 0.05, np.arange(24) * 0.05, np.arange(32) * 0.05
    >>> place = np.exp(1j * (kx[:, None, None] * x + ky[:, None, None] * y[:, None]))
    >>> phase = np.exp(2j * np.pi * rng.random(200) - 1j * np.outer(t, dispersion(k)))
    >>> w = np.tensordot(phase / k, place, 1).real
    >>> field = xr.DataArray(w, {"time": t, "y": y, "x": x}, ("time", "y", "x"), attrs={"units": "m s-1"})
    >>> found = resonances(field, settings=ResonanceSettings(modes=30, surrogates=3))
    >>> int(found.modes), int(found.samples)
    (30, 15)
    >>> bool(found.quartet_significant.any()), bool(found.triad_significant.any())
    (False, False)
    """
    settings = settings or ResonanceSettings()
    name = "w" if field.name is None else str(field.name)
    if name in ("z", "w", "z_t"):
        field = validate(field.to_dataset(name=name), name)[name]
    record = find_record(field) if record is None else record
    if density is None:
        density = spectrum(field, record=record)["E"].compute()
    lattice = _lattice(density, (depth, gamma), current, record.dt, settings)
    if lattice.free.size < 4:
        raise CubeError(
            f"{lattice.free.size} wave vectors hold free waves above the noise: coherences of four need four"
        )
    x = _segment_lines(_amplitudes(field, record, lattice), settings.segment)
    memory = _autocorrelation(x)
    kinds = {
        "quartet": _quartets(lattice, x.shape[2], settings.mismatch),
        "triad": _triads(lattice, x.shape[2]),
    }
    nulls: dict[str, list[_Coherences]] = {kind: [] for kind in kinds}
    for surrogate in _surrogates(x, settings.surrogates, np.random.default_rng(0)):
        for kind, groups in kinds.items():
            nulls[kind].append(_coherences(surrogate, memory, groups))
    width = 2 * np.pi / (settings.segment * record.dt)
    coords = {"mismatch": np.arange(-settings.mismatch, settings.mismatch + 1) * width}
    out: dict[str, Any] = {"modes": ((), lattice.free.size), "samples": ((), x.shape[1])}
    for kind, groups in kinds.items():
        measured, null = _coherences(x, memory, groups), nulls[kind]
        resonant = np.ones(len(groups.cells), bool)
        if kind == "quartet":
            resonant = np.abs(groups.mismatch) <= 1
            out |= _excess_by_mismatch(groups, measured, null, settings.mismatch)
        chance = np.concatenate([one.score[resonant] for one in null])
        p = np.ones(int(resonant.sum()))
        if chance.size > LEAST_NULL:
            p = probabilities(measured.score[resonant], chance)
        # Benjamini and Hochberg (1995)
        significant = stats.false_discovery_control(p) <= settings.false_discovery
        first = np.argsort(p, kind="stable")[: settings.listed]
        listed = groups[resonant][first]
        out |= _listed(kind, measured[resonant][first], p[first], significant[first])
        k, dims = lattice.k(listed.cells), (kind, f"{kind}_wave")
        out |= {
            f"{kind}_kx": (dims, k[..., 1]),
            f"{kind}_ky": (dims, k[..., 0]),
            f"{kind}_omega": (dims, listed.line * width),
            f"{kind}_mismatch": (kind, listed.mismatch * width),
            f"{kind}_tests": ((), p.size),
        }
    return annotate(xr.Dataset(out, coords, {"segment": settings.segment}), "resonances")


def _excess_by_mismatch(
    quartets: _Groups, measured: _Coherences, null: list[_Coherences], max_mismatch: int
) -> dict[str, Any]:
    """Mean squared coherence less that of the surrogates, by mismatch, with its standard uncertainty.

    Quartets share waves: their mean varies more than that of as many independent values, by one factor for
    all mismatches, which the surrogates' means at all of them determine.
    """
    classes = np.arange(-max_mismatch, max_mismatch + 1)
    rows = np.full((classes.size, 3), np.nan)
    alone, varied = np.full(classes.size, np.nan), np.full(classes.size, np.nan)
    for i, mismatch in enumerate(classes):
        chosen = quartets.mismatch == mismatch
        rows[i, 2] = chosen.sum()
        if not chosen.any():
            continue
        values = np.array([one.squared[chosen] for one in null])
        means = values.mean(axis=1)
        rows[i, 0] = measured.squared[chosen].mean() - means.mean()
        if len(null) > 1:
            alone[i] = values.var(axis=0, ddof=1).sum() / chosen.sum() ** 2
            varied[i] = means.var(ddof=1)
    usable = alone > 0
    if usable.any():
        shared = (varied[usable] / alone[usable]).mean()
        rows[:, 1] = np.sqrt(
            alone * shared * (1 + 1 / len(null))
        )  # the mean of the surrogates varies as well
    names = "coherence_excess", "coherence_excess_std", "quartets"
    return {name: ("mismatch", column) for name, column in zip(names, rows.T)}


def _listed(kind: str, best: _Coherences, p: Array, significant: Array) -> dict[str, Any]:
    std = np.sqrt(2 * best.squared / np.maximum(best.samples, 2)) * (1 - best.squared)
    return {
        f"{kind}_coherence": (kind, best.squared),
        f"{kind}_coherence_std": (kind, std),
        f"{kind}_probability": (kind, p),
        f"{kind}_significant": (kind, significant),
    }


def _group(
    cube: xr.Dataset, depth: float, gamma: float, used: CurrentUsed, density: xr.DataArray, welch: Welch
) -> xr.Dataset:
    current, record = used.velocity, welch.record
    out = resonances(cube["w"], depth, gamma=gamma, current=current, density=density, record=record)
    return out.assign_attrs(used.attrs)


register(
    Product(
        "resonances",
        ("cube", "depth", "gamma", "fitted_or_given_current", "density_w", "welch"),
        _group,
        group="resonances",
        without="No coherence of wave vectors",
        cost=5,
    )
)
