"""Coverage of the wave estimators on random seas of an independent generator.

    python -m benchmarks.waves [--first SEED] [--draws N] [--processes N] [--save]

Gaussian seas of exact free waves are drawn at random: depth, current, directions (isotropic to s = 50, one or
two parts), band, slope, noise, length, window, gaps, sampling. `analyze` is run on two draws of each sea. The
table has, by product, the fraction of 95 % intervals that hold the truth (of currents) or the difference of
the two draws (of other products, whose truth is the same), how often 5 % levels are exceeded where there is
no relation, and what was refused. The family of seas that departs most is named beside.
"""

import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "waves"))

from independent_seas import random_lattice_sea

from benchmarks.results import parser_of, print_table, save_result
from wavefield.errors import CubeError
from wavefield.waves import analyze, coherence

Array = NDArray[Any]

STRONG = 1e-3  # of the largest energy: weaker cells are not counted
HALF_INTERVAL = 1.96  # standard uncertainties
# whose truth is known, and its place: the current along x and y
TRUTH = {
    ("kinematics", "mean_current_x"): 0,
    ("kinematics", "mean_current_y"): 1,
    ("dispersion", "current_x"): 0,
    ("dispersion", "current_y"): 1,
}
SPREADS = {"pdf", "static"}  # whose standard deviation is no uncertainty
FEW = 5  # draws: a family with fewer is not named
Count = tuple[str, str, float]  # kind, product, fraction
SeaCounts = tuple[int, list[str], list[Count]]  # seed, families


def _factors(tree: xr.DataTree, group: str) -> Iterator[tuple[str, Array, Array, Array, Array]]:
    """Estimates of a group with intervals: product, values, ends as factors, and where they count."""
    data = tree[group].to_dataset()
    if group == "spectra":
        for name in data["quantity"].values:
            one = data.sel(quantity=name)
            for end, text in (("", "E(k, omega)"), ("_k", "E(k)"), ("_omega", "E(omega)")):
                energy, low, high = (one[f"{part}{end}"].values for part in ("E", "low", "high"))
                yield f"{text} of {name}", energy, low, high, _counted(energy, True if end else one["valid"])
        for source in data["source"].values:
            one = data.sel(source=source)
            energy, low, high = (one[part].values for part in ("Ez", "low_Ez", "high_Ez"))
            yield f"Ez_{source}", energy, low, high, _counted(energy, one["valid_Ez"])
    elif group == "direction" and "D" in data:
        density, low, high = (data[name].values for name in ("D", "low_D", "high_D"))
        yield "D(theta)", density, low, high, _counted(density, np.isfinite(low) & np.isfinite(high))
    elif group == "kinematics":
        for axis in ("k", "omega"):
            name = f"nonlinear_ratio_{axis}"
            ratio, low, high = (data[end + name].values for end in ("", "low_", "high_"))
            energy = tree["spectra"][f"E_{axis}"].sel(quantity="w").values
            yield name, ratio, low, high, _counted(energy, np.isfinite(ratio + low + high) & (ratio > 0))


def _counted(energy: Array, valid: Any) -> Array:
    """Where an estimate is strong enough to count."""
    there = np.isfinite(energy) & (energy > 0) & np.asarray(valid)
    return np.asarray(there & (energy > STRONG * np.nanmax(np.where(there, energy, 0))))


def _intervals(one: xr.DataTree, other: xr.DataTree) -> Iterator[Count]:
    """Fraction of intervals of two estimates of the same truth that hold it, by product."""
    for group in one.children:
        if group not in other.children:
            continue
        pairs = zip(_factors(one, group), _factors(other, group))
        for (product, a, low_a, high_a, there), (_, b, low_b, high_b, there_b) in pairs:
            if a.shape != b.shape or not (there & there_b).any():
                continue
            with np.errstate(all="ignore"):
                apart = np.log(b / a)
                up = np.hypot(np.log(high_a), np.log(low_b))
                down = np.hypot(np.log(low_a), np.log(high_b))
                inside = np.where(apart > 0, apart <= up, -apart <= down)
            yield "interval", f"{group}: {product}", float(inside[there & there_b].mean())
        for name in one[group].data_vars:
            value = str(name).removesuffix("_std")
            if value == name or value in SPREADS or (group, value) in TRUTH:
                continue
            if not {value, name} <= {*other[group].data_vars}:
                continue
            if value not in one[group]:
                continue
            a, b, std_a, std_b = (t[group][n].values for n in (value, name) for t in (one, other))
            if a.shape != b.shape or a.shape != std_a.shape:
                continue
            if (there := np.isfinite(a + b + std_a + std_b)).any():
                apart = a - b
                if one[group][value].attrs.get("units") == "rad":
                    apart = np.angle(np.exp(1j * apart))
                inside = np.abs(apart) <= HALF_INTERVAL * np.hypot(std_a, std_b)
                yield "interval", f"{group}: {value}", float(inside[there].mean())


def _against_truth(tree: xr.DataTree, current: tuple[float, float]) -> Iterator[Count]:
    """Fraction of intervals that hold a truth which is known."""
    for (group, name), place in TRUTH.items():
        if group in tree.children and name in tree[group].data_vars:
            value, std = (tree[group][n].values for n in (name, f"{name}_std"))
            inside = np.abs(value - current[place]) <= HALF_INTERVAL * std
            yield "truth", f"{group}: {name.removesuffix('_x').removesuffix('_y')}", float(inside.mean())


def _nulls(tree: xr.DataTree, mixed: xr.Dataset) -> Iterator[Count]:
    """Fraction of coherences without relation that exceed their level."""
    spectra, group = tree["spectra"], tree["coherence"]
    for ending, over, energy in (("", "", spectra["E_k"]), ("_komega", ", over k and omega", spectra["E"])):
        strong = energy > STRONG * energy.max([dim for dim in energy.dims if dim != "quantity"])
        rise, w, nl = (strong.sel(quantity=name).values for name in ("rise", "w", "nl"))
        waves = rise & spectra["valid"].values if ending else rise & w
        for product, data, term, part in (
            (f"z_t with u . grad z{over}", group, "nl", waves & nl if ending else rise & nl),
            (f"z_t with w of another sea{over}", mixed, "w", waves),
        ):
            above = (data[f"gamma2{ending}"] > data[f"level{ending}"]).sel(term=term).values
            if part.any() and above.shape == part.shape:
                yield "null", f"coherence: {product}", float(above[part].mean())
    for name in ("bicoherence", "tricoherence"):
        if "higher_order" in tree.children and name in tree["higher_order"]:
            value, level = (tree["higher_order"][n].values for n in (name, f"{name}_level"))
            if (there := np.isfinite(value) & np.isfinite(level)).any():
                yield "null", f"higher_order: {name}", float((value > level)[there].mean())


def counts_of(seed: int) -> SeaCounts:
    """What is counted on two draws of a random sea."""
    sea, families = random_lattice_sea(seed)
    cubes = [sea.cube(10 * seed + i) for i in (1, 2)]
    out: list[Count] = []
    try:
        trees = [analyze(cube) for cube in cubes]
    except CubeError as error:
        return seed, families, [("refusal", f"analyze: {error}", 1.0)]
    mixed = cubes[0][["z", "z_t"]].assign({name: cubes[1][name] for name in ("u", "v", "w")})
    out += _intervals(*trees)
    for tree in trees:
        out += _nulls(tree, coherence(mixed.assign_attrs(cubes[0].attrs)))
        notes = [
            line.partition(":")[0] for line in tree.attrs["notes"].splitlines() if line.startswith("No ")
        ]
        out += [("refusal", note, 1.0) for note in notes]
        out += _against_truth(tree, sea.current)
    print(f"sea {seed}: {', '.join(families)}", file=sys.stderr, flush=True)
    return seed, families, out


def _mean(fractions: Sequence[float]) -> tuple[float, float]:
    """Mean of fractions of several draws, and its standard error."""
    error = np.std(fractions, ddof=1) / np.sqrt(len(fractions)) if len(fractions) > 1 else np.nan
    return float(np.mean(fractions)), float(error)


def _off(expected: float, mean: float, error: float) -> float:
    """How far a mean is from what is expected, in standard errors; one of equal fractions has a small one."""
    return abs(mean - expected) / max(error, 0.01)


def products_table(seeds: Sequence[int], processes: int) -> list[list[str]]:
    """Rows of the table of products, the worst of each kind first."""
    with Pool(processes) as pool:
        seas = pool.map(counts_of, seeds, chunksize=1)
    found: dict[tuple[str, str], list[tuple[float, list[str]]]] = defaultdict(list)
    for _, families, counts in seas:
        for kind, product, fraction in counts:
            found[kind, product].append((fraction, families))
    rows = []
    for (kind, product), values in found.items():
        expected = {"interval": 0.95, "truth": 0.95, "null": 0.05}.get(kind, 0.0)
        mean, error = _mean([fraction for fraction, _ in values])
        by_family = defaultdict(list)
        for fraction, families in values:
            for name in families:
                by_family[name].append(fraction)
        of_family = {name: _mean(v) for name, v in by_family.items() if len(v) >= FEW}
        worst = max(of_family, default="", key=lambda name: _off(expected, *of_family[name]))
        count = f"{len(values)}" if kind != "refusal" else f"{len(values)} of {2 * len(seeds)}"
        mean_text = f"{mean:.3f} ± {error:.3f}" if kind != "refusal" else ""
        worst_text = "{} {:.3f} ± {:.3f}".format(worst, *of_family[worst]) if worst else ""
        rows.append((abs(mean - expected), [kind, product, count, mean_text, worst_text]))
    order = ("interval", "truth", "null", "refusal")
    rows.sort(key=lambda row: (order.index(row[1][0]), -row[0]))
    return [cells for _, cells in rows]


COLUMNS = ("kind", "product", "pairs", "fraction", "worst family")


def main() -> None:
    """Measure and print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--first", type=int, default=9000, help="seed of the first sea")
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    rows = products_table(range(given.first, given.first + given.draws), given.processes)
    print_table(COLUMNS, rows)
    if given.save:
        save_result("waves", COLUMNS, rows, measures_images=False)


if __name__ == "__main__":
    main()
