"""Three- and four-wave coherence of wave vectors: which triads and quartets exchange energy or force others.

Kernels take lines X (cells, segments, lines): amplitudes of exp(i (k . x - omega t)) on a lattice of k.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import GAMMA, dispersion
from wavefield.waves.dispersion_relation.current_used import CurrentUsed
from wavefield.waves.estimation.multiple_testing import probabilities, significant_tests
from wavefield.waves.estimation.segments import Reader, spatial_window
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.estimation.windows import hann
from wavefield.waves.products import Product, register
from wavefield.waves.spectra.field_spectra import spectrum

Array = NDArray[Any]

_THIN = 2  # every second cell: a Hann window makes neighbours alike
_APART = 2  # of these cells: nearer wave vectors are the same wave to the windows, and pair trivially
_LONGEST = 2.5  # cells
_SHORTEST = 0.8  # of the Nyquist wavenumber
_CELLS = 700  # wave vectors held over time
_MIN_PEAK_TO_NOISE = 3.0  # energy on the ridge over what lies beside it
_LEAST = 8  # segments
_LAGS = 24  # segments over which lines may remember themselves
_BATCH = 2048  # coherences computed at a time
_PIECE = 256  # steps transformed in space at a time


@dataclass(frozen=True)
class ResonanceSettings:
    """What of the wave-vector coherences is computed.

    Parameters
    ----------
    segment : int
        Steps of a segment: short ones give the samples that a small coherence needs.
    modes : int
        At most so many wave vectors of free waves, the strongest.
    mismatch : int
        Quartets are looked at up to so many lines off resonance.
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
    """Wave vectors on every second cell, with the line of the ridge at each."""

    n: NDArray[np.int64]  # (cells, 2), rows and columns, in units of two cells
    steps: tuple[float, float]  # of ky and kx, rad/m
    line: NDArray[np.int64]  # (cells,), of the ridge; 0 where it is beyond the spectrum
    free: NDArray[np.int64]  # cells that hold free waves
    cell: dict[tuple[int, int], int]

    def k(self, cells: Array) -> Array:
        return np.asarray(self.n[cells] * np.array(self.steps))


def _lattice(
    density: xr.DataArray, depth: float, gamma: float, current: tuple[float, float], dt: float, s: Any
) -> _Lattice:
    ky, kx = (density[name].values.astype(float) for name in ("ky", "kx"))
    steps = _THIN * float(ky[1] - ky[0]), _THIN * float(kx[1] - kx[0])
    limit = _SHORTEST * min(-ky.min(), -kx.min())
    limit = min(limit, np.sqrt(_CELLS * steps[0] * steps[1] / np.pi))
    reach = [int(limit / step) for step in steps]
    n = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach), indexing="ij"), axis=-1).reshape(-1, 2)
    k = np.hypot(*(n * np.array(steps)).T)
    n, k = n[(k > 0) & (k <= limit)], k[(k > 0) & (k <= limit)]
    vectors = n * np.array(steps)
    omega = dispersion(k, depth, gamma) + vectors[:, 0] * current[1] + vectors[:, 1] * current[0]
    width = 2 * np.pi / (s.segment * dt)
    line = np.rint(omega / width).astype(np.int64)
    inside = (line >= 2) & (line < s.segment // 2 - 1)
    # energy on the ridge beside what lies one and a half lines off and further
    rows, columns = (np.abs(axis[:, None] - v).argmin(axis=0) for axis, v in zip((ky, kx), vectors.T))
    energy = density.values[:, rows, columns]
    off = np.abs(density["omega"].values[:, None] - omega)
    there = np.where(off < width, energy, 0.0).sum(axis=0) / np.maximum((off < width).sum(axis=0), 1)
    beside = np.nanmedian(np.where(off > 1.5 * width, energy, np.nan), axis=0)
    good = inside & (k > _LONGEST * max(steps) / _THIN) & (there > _MIN_PEAK_TO_NOISE * beside)
    free = np.flatnonzero(good)
    free = np.sort(free[np.argsort(-there[free], kind="stable")][: s.modes])
    cell = {(int(a), int(b)): i for i, (a, b) in enumerate(n)}
    return _Lattice(n, steps, np.where(inside, line, 0), free, cell)


def _amplitudes(field: xr.DataArray, record: Record, lattice: _Lattice) -> list[Array]:
    # (cells, steps) of each run; F(-k) = F(k)* of a real field
    ny, nx = record.shape
    window = spatial_window(ny, nx)
    row, column = (_THIN * lattice.n).T
    mirror = column < 0
    row, column = np.where(mirror, -row, row) % ny, np.abs(column)
    read = Reader([field], record)
    out = []
    for run in record.runs:
        parts = []
        for a in range(run[0], run[1], _PIECE):
            block = read(a, min(a + _PIECE, run[1]), run)[0] * window.astype(np.float32)
            along_x = fft.rfft(block, axis=2)[:, :, : column.max() + 1]  # columns beyond hold nothing wanted
            picked = fft.fft(along_x, axis=1)[:, row, column]
            parts.append(np.where(mirror, picked.conj(), picked).T.astype(np.complex64))
        out.append(np.concatenate(parts, axis=1))
    return out


def segment_lines(runs: list[Array], segment: int) -> Array:
    """Fourier lines of amplitudes in time.

    With runs (cells, steps); returns (cells, segments, segment // 2): Lines of waves exp(-i omega t), omega
    from zero on, each over its rms.
    """
    half, window = segment // 2, hann(segment).astype(np.float32)
    lines = []
    for run in runs:
        for a in range(0, run.shape[1] - segment + 1, half):
            part = run[:, a : a + segment]
            part = (part - part.mean(axis=1, keepdims=True)) * window
            lines.append(fft.ifft(part, axis=1)[:, : segment // 2])
    if len(lines) < _LEAST:
        raise CubeError(
            f"the record holds {len(lines)} segments of {segment} steps: coherences of wave vectors need"
            f" {_LEAST}"
        )
    x = np.stack(lines, axis=1)
    # coherences are of any scale; products of four in single precision are not
    size = np.sqrt((np.abs(x) ** 2).mean(axis=1, dtype=np.float64, keepdims=True))
    return np.asarray(np.divide(x, size, out=np.zeros_like(x), where=size > 0), np.complex64)


def surrogates(lines: Array, count: int, rng: np.random.Generator) -> Iterator[Array]:
    """Surrogates of lines: phases of each line's spectrum over the record drawn anew.

    With lines (cells, segments, lines); returns (cells, segments, lines): The same power and memory of each
    line, no relation between lines.
    """
    spectra = fft.fft(lines, axis=1)
    turn = np.empty_like(spectra)
    for _ in range(count):
        angle = rng.random(spectra.shape, dtype=np.float32) * np.float32(2 * np.pi)
        np.cos(angle, out=turn.real)
        np.sin(angle, out=turn.imag)
        turn *= spectra
        yield np.asarray(fft.ifft(turn, axis=1))


def memory_of(lines: Array) -> Array:
    """How long lines remember themselves.

    With lines (cells, segments, lines); returns (cells, lines, lags): Autocorrelation at lags of 1, 2, ...
    segments.
    """
    count = lines.shape[1]
    lags = min(_LAGS, count // 4)
    power = np.abs(fft.fft(lines, n=2 * count, axis=1)) ** 2
    correlation = fft.ifft(power, axis=1)[:, : lags + 1]
    return np.asarray(np.moveaxis(correlation[:, 1:] / np.maximum(correlation[:, :1].real, 1e-300), 1, 2))


@dataclass(frozen=True)
class _Tests:
    """Triads or quartets: who takes part, at which line, and how far the last is off its ridge."""

    who: NDArray[np.int64]  # (tests, 3) or (tests, 4) cells
    line: NDArray[np.int64]  # the same shape
    mismatch: NDArray[np.int64]  # (tests,) lines

    def __getitem__(self, chosen: Array) -> "_Tests":
        return _Tests(self.who[chosen], self.line[chosen], self.mismatch[chosen])


@dataclass(frozen=True)
class _Found:
    """Squared coherence, |sum|^2 over what chance gives, independent samples, each (tests,)."""

    squared: Array
    score: Array
    samples: Array

    def __getitem__(self, chosen: Array) -> "_Found":
        return _Found(self.squared[chosen], self.score[chosen], self.samples[chosen])


def _pairs(lattice: _Lattice) -> dict[tuple[int, int], Array]:
    # pairs of free waves by the sum of their wave vectors
    i, j = np.triu_indices(lattice.free.size)
    first, second = lattice.free[i], lattice.free[j]
    total = lattice.n[first] + lattice.n[second]
    groups: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for key, a, b in zip(map(tuple, total.tolist()), first.tolist(), second.tolist()):
        groups[key].append((a, b))
    return {key: np.array(pairs) for key, pairs in sorted(groups.items())}


def _far(lattice: _Lattice, a: Array, b: Array) -> Array:
    # whether wave vectors are told apart by the windows
    return np.asarray(np.abs(lattice.n[a] - lattice.n[b]).max(axis=-1) >= _APART)


def _quartets(lattice: _Lattice, lines: int, most: int) -> _Tests:
    who = []
    for pairs in _pairs(lattice).values():
        p, q = np.triu_indices(len(pairs), 1)
        who.append(np.concatenate([pairs[p], pairs[q]], axis=1))
    all_four = np.concatenate(who)
    first, _, third, fourth = all_four.T
    all_four = all_four[_far(lattice, first, third) & _far(lattice, first, fourth)]
    line = lattice.line[all_four]
    off = line[:, 0] + line[:, 1] - line[:, 2] - line[:, 3]  # by so much the fourth wave's line is moved
    line[:, 3] += off
    good = (np.abs(off) <= most) & (line[:, 3] >= 1) & (line[:, 3] < lines)
    return _Tests(all_four[good], line[good], off[good])


def _triads(lattice: _Lattice, lines: int) -> _Tests:
    who = [
        np.column_stack([pairs, np.full(len(pairs), lattice.cell[total])])
        for total, pairs in _pairs(lattice).items()
        if total in lattice.cell and lattice.line[lattice.cell[total]]
    ]
    all_three = np.concatenate(who) if who else np.zeros((0, 3), np.int64)
    line = lattice.line[all_three]
    off = line[:, 0] + line[:, 1] - line[:, 2]
    line[:, 2] += off
    good = line[:, 2] < lines
    return _Tests(all_three[good], line[good], off[good])


def _coherences(x: Array, memory: Array, tests: _Tests) -> _Found:
    parts = []
    for a in range(0, len(tests.who), _BATCH):
        who, line = tests.who[a : a + _BATCH].T, tests.line[a : a + _BATCH].T
        waves = [x[c, :, i] for c, i in zip(who, line)]
        remembers = [memory[c, i] for c, i in zip(who, line)]
        one, other = waves[0] * waves[1], waves[2] * waves[3] if len(waves) == 4 else waves[2]
        of_other = remembers[2] * remembers[3] if len(waves) == 4 else remembers[2]
        # what remembers itself for long has fewer samples
        longer = 1 + 2 * (remembers[0] * remembers[1] * of_other.conj()).sum(axis=1).real
        cross = np.abs((one * other.conj()).sum(axis=1)) ** 2
        powers = np.abs(one) ** 2, np.abs(other) ** 2
        norm = np.maximum(powers[0].sum(axis=1) * powers[1].sum(axis=1), 1e-300)
        chance = np.maximum((powers[0] * powers[1]).sum(axis=1) * np.maximum(longer, 1.0), 1e-300)
        parts.append(np.stack([cross / norm, cross / chance, norm / chance]))
    return _Found(*(np.concatenate(parts, axis=1) if parts else np.zeros((3, 0))))


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
    """Triads and quartets of wave vectors whose phases belong together, on resonance and off it.

    Parameters
    ----------
    field : DataArray, (time, y, x)
        Best w of a cube; z will do. Read once, in pieces; computed at once.
    depth : float
        Depth of the water, m.
    gamma : float
        Surface tension over density, m3/s2.
    current : tuple of float
        Along x and y, m/s (`fit_dispersion`).
    density : DataArray, (omega, ky, kx), optional
        Its spectrum, which tells where waves are; computed if not given.
    record : Record, optional
        Rectangle and runs; found from the field if not given.
    settings : ResonanceSettings, optional
        Segments, number of wave vectors, rate of false discoveries.

    Returns
    -------
    Dataset
        The least probable ``quartet``: wave vectors ``quartet_kx``, ``quartet_ky`` and ``quartet_omega``
        (quartet, wave), k1 + k2 = k3 + k4; ``quartet_coherence``, its ``_std``, ``quartet_probability``,
        ``quartet_significant``, ``quartet_mismatch``, how far in rad/s the fourth wave lies off the ridge.
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
    sum of frequencies exact: within a line of the ridge it is a resonance, further off a forced wave. Pairs
    that the windows do not tell apart are left out. Probabilities are those of records whose lines have the
    same spectra and random phases, pooled over all quartets after division by their own memory; discoveries
    are controlled over the whole map (Benjamini and Hochberg 1995). See Aubourg and Mordant 2015 (arXiv
    1503.04110), Campagne et al. 2019 (arXiv 1906.06385). With N samples a single squared coherence is known
    to 1 / N: smaller ones show in ``coherence_excess``.

    Examples
    --------
    Two hundred waves whose phases have nothing to do with each other.

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
    s = settings or ResonanceSettings()
    name = "w" if field.name is None else str(field.name)
    field = validate(field.to_dataset(name=name), name)[name] if name in ("z", "w", "z_t") else field
    record = find_record(field) if record is None else record
    if density is None:
        density = spectrum(field, record=record)["E"].compute()
    lattice = _lattice(density, depth, gamma, current, record.dt, s)
    if lattice.free.size < 4:
        raise CubeError(
            f"{lattice.free.size} wave vectors hold free waves that stand out: coherences of four need four"
        )
    x = segment_lines(_amplitudes(field, record, lattice), s.segment)
    memory = memory_of(x)
    kinds = {
        "quartet": _quartets(lattice, x.shape[2], s.mismatch),
        "triad": _triads(lattice, x.shape[2]),
    }
    nulls: dict[str, list[_Found]] = {kind: [] for kind in kinds}
    for copy in surrogates(x, s.surrogates, np.random.default_rng(0)):
        for kind, tests in kinds.items():
            nulls[kind].append(_coherences(copy, memory, tests))
    width = 2 * np.pi / (s.segment * record.dt)
    coords = {"mismatch": np.arange(-s.mismatch, s.mismatch + 1) * width}
    out: dict[str, Any] = {"modes": ((), lattice.free.size), "samples": ((), x.shape[1])}
    for kind, tests in kinds.items():
        found, null = _coherences(x, memory, tests), nulls[kind]
        near = np.abs(tests.mismatch) <= 1 if kind == "quartet" else np.ones(len(tests.who), bool)
        if kind == "quartet":
            out |= _curve(tests, found, null, s.mismatch)
        chance = np.concatenate([n.score[near] for n in null])
        out |= _listed(kind, tests[near], found[near], chance, lattice, width, s)
        out[f"{kind}_tests"] = ((), int(near.sum()))
    return annotate(xr.Dataset(out, coords, {"segment": s.segment}), "resonances")


def _curve(tests: _Tests, found: _Found, null: list[_Found], most: int) -> dict[str, Any]:
    rows = []
    for d in range(-most, most + 1):
        there = tests.mismatch == d
        if not there.any():
            rows.append((np.nan, np.nan, 0))
            continue
        # quartets share waves: the spread of the surrogates' means tells how surely the mean is known
        means = np.array([n.squared[there].mean() for n in null])
        std = means.std(ddof=1) if means.size > 1 else np.nan
        rows.append((found.squared[there].mean() - means.mean(), std, there.sum()))
    excess, std, count = np.array(rows).T
    return {
        "coherence_excess": ("mismatch", excess),
        "coherence_excess_std": ("mismatch", std),
        "quartets": ("mismatch", count),
    }


def _listed(
    kind: str,
    tests: _Tests,
    found: _Found,
    null: Array,
    lattice: _Lattice,
    width: float,
    s: ResonanceSettings,
) -> dict[str, Any]:
    p = probabilities(found.score, null) if null.size > 50 else np.ones(found.score.size)
    significant = significant_tests(p, s.false_discovery)
    first = np.argsort(p, kind="stable")[: s.listed]
    best, which, dims = found[first], tests[first], (kind, f"{kind}_wave")
    k = lattice.k(which.who)
    value = best.squared
    std = np.sqrt(2 * value / np.maximum(best.samples, 2)) * (1 - value)
    return {
        f"{kind}_kx": (dims, k[..., 1]),
        f"{kind}_ky": (dims, k[..., 0]),
        f"{kind}_omega": (dims, which.line * width),
        f"{kind}_coherence": (kind, value),
        f"{kind}_coherence_std": (kind, std),
        f"{kind}_probability": (kind, p[first]),
        f"{kind}_significant": (kind, significant[first]),
        f"{kind}_mismatch": (kind, which.mismatch * width),
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
