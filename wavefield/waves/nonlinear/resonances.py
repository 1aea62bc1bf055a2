"""Three- and four-wave coherence of wave vectors: which triads and quartets exchange energy or force others.

Fourier lines are amplitudes of exp(i (k . x - omega t)) at cells of the k plane.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import GAMMA
from wavefield.waves.dispersion_relation.current_used import CurrentUsed
from wavefield.waves.estimation.inputs import a_field, takes
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.nonlinear import resonance_lines as rl
from wavefield.waves.nonlinear.resonance_groups import (
    Groups,
    Waves,
    free_waves,
    quartets,
    quartets_of_pair,
    triads,
)
from wavefield.waves.products import Product, register
from wavefield.waves.spectra.field_spectra import spectrum

Array = NDArray[Any]

LEAST_NULL = 50  # scores of surrogates: fewer give no probabilities
SHARES = np.arange(1, 10) / 10  # of a planted quartet
TRIED = 200  # quartets in which one is planted, for each surrogate
SAME_WAVE = 0.25  # squared correlation of two cells that hold one wave
RARE, LEAST_SHARED = 9.0, 3.0  # squared correlations over that by chance
SHARED = 0.3  # of the coherence by chance: pairs whose waves share more are no test of coupling
CHANCE = 0.05  # of the level of the map


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
        The excess of quartets is given up to so many lines off resonance.
    surrogates : int
        Phase-randomised copies of the record.
    false_discovery : float
        Fraction of false ones among the triads, and among the quartets, that are called significant.
    listed : int
        At most so many are listed, the least probable first.
    pair : two pairs of float, optional
        Wave vectors (kx, ky) of k1 and k2 of the map, rad/m: the free waves nearest to them are taken. By
        default the strongest one, and the strongest of those that the windows resolve from it.
    """

    segment: int = 64
    modes: int = 100
    mismatch: int = 4
    surrogates: int = 6
    false_discovery: float = 0.02
    listed: int = 200
    pair: tuple[tuple[float, float], tuple[float, float]] | None = None


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
        (quartet, wave), k1 + k2 = k3 + k4 to a cell; ``quartet_coherence``, its ``_std``,
        ``quartet_probability``, ``quartet_significant``, ``quartet_mismatch``, rad/s by which the fourth wave
        is off its free frequency, its ``_std``. The same for ``triad``, k1 + k2 = k3. ``power`` over
        ``share``: the part of quartets that would be found if such a share of the power of their fourth
        wave's line were driven by the lines of the other three; noise and other waves in these lines count as
        power that is not. Over ``mismatch``: ``coherence_excess``, the mean over all quartets of the squared
        coherence less what the autocorrelations of its waves lead to, its ``_std``, and ``quartets``, how
        many. At the fixed k1 and k2 ``map_pair_kx``, ``map_pair_ky`` (map_pair): ``map_coherence`` of their
        quartets over k3, ``map_mismatch``, 0 on the curve of resonance, and ``map_level``, exceeded by chance
        in 5 %. Also ``quartet_tests``, ``triad_tests``, ``modes``, ``samples``.

    Raises
    ------
    CubeError
        If the record is too short or fewer than four wave vectors hold free waves.

    Notes
    -----
    Squared coherence |<a1 a2 a3* a4*>|^2 / (<|a1 a2|^2> <|a3 a4|^2>), and |<a1 a2 a3*>|^2 / (<|a1 a2|^2>
    <|a3|^2>), within [0, 1]; a are amplitudes in Hann-windowed segments of free waves, none nearer than two
    cells of the k plane to a stronger one, each at its own frequency (the mean over its line, weighted by the
    squared energy) to a quarter of a segment's line; that of the last makes the sum of frequencies exact.
    Quartets within a line of the free frequency are tested, pairs that the windows do not resolve are left
    out. The test takes, of the four waves, that with the largest part of its power in common with the product
    of the other three (of N samples q^(N - 1) of Gaussian waves have more than 1 - q by chance), in segments
    divided by the rms of all waves in them. Probabilities are those of records whose lines have the same
    spectra and random phases, pooled over all quartets; discoveries are controlled over all tests (Benjamini
    and Hochberg 1995), weighted by one over the squared rank of the weakest wave (Genovese et al. 2006), and
    the power is that of a single one among them. See Aubourg and Mordant 2015 (arXiv
    1503.04110), Campagne et al. 2019 (arXiv 1906.06385). With N samples a single squared coherence is
    determined to 1 / N: smaller ones show in ``coherence_excess``.

    Examples
    --------
    Two hundred waves of independent phases.

    >>> from wavefield.water import dispersion
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
    (30, 29)
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
    waves, pair = _waves(density, (depth, gamma), current, record, settings)
    all_quartets = quartets(waves, (settings.mismatch + 0.5) * waves.width)
    resonant = np.abs(all_quartets.mismatch) <= waves.width
    kinds = {
        "quartet": all_quartets[resonant],
        "triad": triads(waves),
        "off resonance": all_quartets[~resonant],
        "map": quartets_of_pair(waves, pair),
    }
    x, places, ends, sea, in_runs = _lines(field, record, waves, kinds, settings.segment)
    memory = rl.autocorrelation(x, ends)
    correlation, by_chance = rl.correlations(x, memory, places.pop("own"))
    for kind in ("quartet", "triad", "off resonance"):
        apart = _share_no_waves(correlation, by_chance, waves, kinds[kind])
        kinds[kind], places[kind] = kinds[kind][apart], places[kind][apart]
    tested = "quartet", "triad"
    measured = {kind: rl.coherences_of(x, memory, at, kind in tested) for kind, at in places.items()}
    nulls: dict[str, list[rl.Coherences]] = {kind: [] for kind in kinds}
    every = slice(None, None, max(1, -(-len(places["quartet"]) // TRIED)))
    tried, at = kinds["quartet"][every], places["quartet"][every]
    rows, line = waves.rank(tried.cells[:, :3]), tried.line[:, 3]
    product = rl.products_of_waves(in_runs, rows, tried.omega[:, :3], line, record.dt, settings.segment) / sea
    own = [memory[place] for place in at.T]
    planted = [rl.coherences(rl.driven(x, at, product, share), own).score for share in SHARES]
    for surrogate in rl.surrogates(x, settings.surrogates, np.random.default_rng(0)):
        own_memory = rl.autocorrelation(surrogate, ends)
        for kind, at in places.items():
            nulls[kind].append(rl.coherences_of(surrogate, own_memory, at, kind in tested))
    out: dict[str, Any] = {"modes": ((), waves.modes.size), "samples": ((), x.shape[1])}
    coords = {
        "mismatch": np.arange(-settings.mismatch, settings.mismatch + 1) * waves.width,
        "share": SHARES,
    }
    both = "quartet", "off resonance"
    of_both = [[measured[kind].excess for kind in both]]
    of_both += [[nulls[kind][i].excess for kind in both] for i in range(settings.surrogates)]
    excess = np.array([np.concatenate(parts) for parts in of_both])
    lines_off = np.rint(np.concatenate([kinds[kind].mismatch for kind in both]) / waves.width)
    out |= _excess_by_mismatch(lines_off, excess[0], excess[1:], settings.mismatch)
    for kind in tested:
        chance = np.concatenate([one.score for one in nulls[kind]] or [np.zeros(0)])
        groups, coherence = kinds[kind], measured[kind]
        p = np.ones(len(groups.cells))
        if chance.size > LEAST_NULL:
            p = rl.probabilities(coherence.score, chance)
        # Benjamini and Hochberg (1995), weighted (Genovese et al. 2006)
        part = _part_of_level(waves, groups)
        significant = stats.false_discovery_control((p / part).clip(None, 1)) <= settings.false_discovery
        first = np.argsort(p / part, kind="stable")[: settings.listed]
        out |= _listed(kind, waves, groups[first], coherence[first], p[first], significant[first])
        out[f"{kind}_tests"] = ((), p.size)
        if kind == "quartet":
            power = np.full(SHARES.size, np.nan)
            if chance.size > LEAST_NULL:
                alone = settings.false_discovery / p.size * part[every]
                power = (rl.probabilities(np.stack(planted), chance) <= alone).mean(axis=1)
            out["power"] = ("share", power)
    found = xr.Dataset(out, coords, {"segment": settings.segment})
    return annotate(
        found.assign(_map(waves, pair, kinds["map"], measured["map"], nulls["map"])), "resonances"
    )


def _waves(
    density: xr.DataArray,
    water: tuple[float, float],
    current: tuple[float, float],
    record: Record,
    settings: ResonanceSettings,
) -> tuple[Waves, Array]:
    """The strongest free waves of a spectrum, and those two whose quartets are mapped."""
    waves, energy = free_waves(density, water, current, settings.segment, record.dt)
    if waves.modes.size < 4:
        raise CubeError(
            f"{waves.modes.size} wave vectors hold free waves above the noise: coherences of four need four"
        )
    # squared relative errors of a spectrum's lines are one over its independent segments
    segments = record.steps_in_runs() * record.dt * float(density.omega[1] - density.omega[0]) / (2 * np.pi)
    strongest = np.argsort(-energy, kind="stable")[: settings.modes]
    waves = replace(
        waves,
        modes=waves.modes[strongest],
        omega=waves.omega[strongest],
        omega_std=waves.omega_std[strongest] / np.sqrt(max(segments, 1.0)),
    )
    k = waves.k(waves.modes)
    if settings.pair is None:
        return waves, np.array([0, 1])
    given = np.array(settings.pair)[:, ::-1]
    return waves, np.hypot(*np.moveaxis(k - given[:, None], -1, 0)).argmin(axis=1)


def _lines(
    field: xr.DataArray, record: Record, waves: Waves, kinds: dict[str, Groups], segment: int
) -> tuple[Array, dict[str, Array], list[int], Array, list[Array]]:
    """Lines (places, segments) over the rms of the sea in each segment, places of groups, ends of runs.
    Also that rms, (segments,), and the amplitudes of free waves in time in each run, (modes, steps).
    """
    size = waves.last + 1
    keys = {kind: groups.cells * size + groups.line for kind, groups in kinds.items()}
    own = waves.modes * size + waves.line(waves.omega)
    unique, index = np.unique(
        np.concatenate([own, *(key.ravel() for key in keys.values())]), return_inverse=True
    )
    lines, ends_of_runs, in_runs = rl.lines_of(
        field, record, (waves.n[unique // size], unique % size), segment, waves.n[waves.modes]
    )
    x = rl.scaled(lines)
    # seas that grow or come in groups: what all waves have in common is no coupling
    sea = np.sqrt((np.abs(x[index[: own.size]]) ** 2).mean(axis=0))
    x /= sea
    ends = np.cumsum([own.size, *(key.size for key in keys.values())])
    own_places, *parts = np.split(index, ends[:-1])
    places = {kind: part.reshape(keys[kind].shape) for kind, part in zip(keys, parts)}
    return rl.scaled(x), {"own": own_places, **places}, ends_of_runs, sea, in_runs


def _part_of_level(waves: Waves, groups: Groups) -> Array:
    """Part of the level that a test has over the mean one, one over the squared rank of its weakest wave.
    The strongest waves exchange most, and few groups are made of them alone.
    """
    part = 1.0 / (1 + waves.rank(groups.cells).max(axis=1, initial=0)) ** 2
    return np.asarray(part / part.mean()) if part.size else part


def _share_no_waves(correlation: Array, by_chance: Array, waves: Waves, groups: Groups) -> NDArray[np.bool_]:
    """Whether groups are without waves that others hold, from the squared correlation of free waves.
    Windows spread the same strong waves into weak cells: they repeat a group, and pairs of them seem coupled.
    """
    same = correlation > np.maximum(SAME_WAVE, RARE * by_chance)
    repeats = np.zeros(len(waves.n), bool)
    for i, cell in enumerate(waves.modes):  # the strongest first
        repeats[cell] = same[i, :i][~repeats[waves.modes[:i]]].any()
    apart = ~repeats[groups.cells].any(axis=1)
    if groups.cells.shape[1] == 4:
        shared = np.sqrt(np.maximum(correlation - LEAST_SHARED * by_chance, 0.0))
        a, b, c, d = waves.rank(groups.cells).T
        limit = SHARED * np.sqrt(by_chance.min())
        apart &= shared[a, c] * shared[b, d] + shared[a, d] * shared[b, c] < limit
    return np.asarray(apart)


def _map(
    waves: Waves, pair: Array, groups: Groups, measured: rl.Coherences, null: list[rl.Coherences]
) -> xr.Dataset:
    """Squared coherence and mismatch of the quartets of a pair over k3, on every second cell."""
    reach = np.abs(waves.n).max(axis=0) // 2
    values = np.full((2, *(2 * reach + 1)), np.nan)
    at = tuple((waves.n[groups.cells[:, 2]] // 2 + reach).T)
    values[0][at], values[1][at] = measured.squared, groups.mismatch
    chance = np.concatenate([one.squared for one in null] or [np.zeros(0)])
    k = waves.k(waves.modes[pair])
    dims = ("map_ky", "map_kx")
    axes = (np.arange(-r, r + 1) * 2 * step for r, step in zip(reach, waves.steps))
    return xr.Dataset(
        {
            "map_coherence": (dims, values[0]),
            "map_mismatch": (dims, values[1]),
            "map_level": ((), np.quantile(chance, 1 - CHANCE) if chance.size else np.nan),
            "map_pair_kx": ("map_pair", k[:, 1]),
            "map_pair_ky": ("map_pair", k[:, 0]),
        },
        dict(zip(dims, axes)),
    )


def _excess_by_mismatch(lines_off: Array, measured: Array, null: Array, max_mismatch: int) -> dict[str, Any]:
    """Mean excess of quartets (groups,) less that of surrogates (surrogates, groups), by mismatch.
    Quartets share waves: their mean varies more, by one factor for all mismatches, from the surrogates.
    """
    classes = np.arange(-max_mismatch, max_mismatch + 1)
    rows = np.full((classes.size, 3), np.nan)
    alone, varied = np.full(classes.size, np.nan), np.full(classes.size, np.nan)
    for i, mismatch in enumerate(classes):
        chosen = lines_off == mismatch
        rows[i, 2] = chosen.sum()
        if not chosen.any():
            continue
        values = null[:, chosen]
        means = values.mean(axis=1)
        rows[i, 0] = measured[chosen].mean() - means.mean()
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


def _listed(
    kind: str, waves: Waves, groups: Groups, best: rl.Coherences, p: Array, significant: Array
) -> dict[str, Any]:
    std = np.sqrt(2 * best.squared / np.maximum(best.samples, 2)) * (1 - best.squared)
    k, dims = waves.k(groups.cells), (kind, f"{kind}_wave")
    return {
        f"{kind}_coherence": (kind, best.squared),
        f"{kind}_coherence_std": (kind, std),
        f"{kind}_probability": (kind, p),
        f"{kind}_significant": (kind, significant),
        f"{kind}_kx": (dims, k[..., 1]),
        f"{kind}_ky": (dims, k[..., 0]),
        f"{kind}_omega": (dims, groups.omega),
        f"{kind}_mismatch": (kind, groups.mismatch),
        f"{kind}_mismatch_std": (kind, groups.mismatch_std),
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
