"""Analysis of a cube: one pass over its Welch segments, then all registered wave products (results).

`wavefield.analyze` writes these results to a Zarr hierarchy. The documentation's page on waves lists its
groups and variables. The wave vector k points where the wave goes: a field is Re sum F exp(i (k . x - omega
t)) over waves with omega > 0 and complex amplitudes F. Spectra are densities per rad/m and rad/s, one-sided
in omega; their integral is the variance. The 95 % interval of a spectrum E extends from ``low`` times E to
``high`` times E. ``valid`` marks the reliable part of a spectrum.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

import wavefield
from wavefield.errors import CubeError
from wavefield.variables import GROUPS, annotate, validate
from wavefield.water import water_of
from wavefield.waves import moments, motion, products
from wavefield.waves.crests import distant_nodes
from wavefield.waves.current import SAMPLED_STEPS, delayed_current
from wavefield.waves.gains import gain_of
from wavefield.waves.inputs import described
from wavefield.waves.record import FIELDS, Each, Record, filled_density, filled_error, find_record
from wavefield.waves.sums import NAMES, Requested, add_segment, transforms
from wavefield.waves.welch import (
    Link,
    Reader,
    Welch,
    add_sums,
    cut_chains,
    states_velocity,
    sum_chain,
    with_stated,
)

Array = NDArray[Any]

Progress = Callable[[int, int], None]


@dataclass
class Sums:
    """Sums over some or all Welch segments of a cube, from which wave products (results) are computed."""

    ring_sums: dict[str, Array] = field(default_factory=dict)  # powers and cross products
    survey_sums: dict[str, Array] = field(default_factory=dict)  # sums of powers and histograms
    balance_rows: list[dict[str, float]] = field(default_factory=list)  # from `motion.balance`
    points: list[Array] = field(default_factory=list)  # w at distant nodes, (time, nodes)

    def __add__(self, other: "Sums") -> "Sums":
        return Sums(
            add_sums(self.ring_sums, other.ring_sums),
            add_sums(self.survey_sums, other.survey_sums),
            self.balance_rows + other.balance_rows,
            self.points + other.points,
        )


@dataclass(frozen=True)
class _Chain:
    """Callable for a worker process: reads up to four consecutive Welch segments and returns their `Sums`."""

    read: Reader
    welch: Welch
    scale: dict[str, tuple[float, float]]  # rough mean and standard deviation of each field
    requested: Requested
    every: int  # steps between two kinematic balances

    def __call__(self, links: Sequence[Link]) -> Sums:
        out = Sums()
        add_powers = partial(add_segment, self.requested, self.welch)
        out.ring_sums = sum_chain(self.read, partial(self._transform, out), add_powers, links)
        return out

    def _transform(
        self, out: Sums, blocks: list[Array], link: Link, memory: dict[str, Array]
    ) -> dict[str, Array]:
        fields = dict(zip(FIELDS, blocks))
        blocks.clear()
        if link.new:
            self._survey(fields, link.start, out)
        # the transforms come last, since they overwrite the fields
        return transforms(fields, self.requested, self.welch, memory)

    def _survey(self, fields: dict[str, Array], start: int, out: Sums) -> None:
        record, current = self.welch.record, self.welch.current
        surveyed = {name: fields[name] for name in self.scale}
        sums = moments.sums_of(surveyed, self.scale, record.dy, record.dx)
        out.survey_sums = add_sums(out.survey_sums, sums)
        out.balance_rows += [
            {"step": float(start + i)} | motion.balance(fields, i, record.dy, record.dx, current)
            for i in range(fields["z"].shape[0])
            if (start + i) % self.every == 0
        ]
        out.points.append(distant_nodes(fields["w"], record).copy())


def _in_threads(work: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
    """Yield ``work(item)`` for each item, in the order of `items`, computed in a pool of threads."""
    with ThreadPoolExecutor(dask.config.get("num_workers")) as pool:
        yield from pool.map(work, items)


def one_pass(
    cube: xr.Dataset, welch: Welch, requested: Requested, progress: Progress | None, each: Each
) -> dict[str, Any]:
    """Read a cube once and return a dictionary of sums over its Welch segments; `products.GIVEN` explains the
    keys. `each(work, items)` yields `work(item)` for groups of up to four segments; `progress(done, total)`
    is called with numbers of groups."""
    record = welch.record
    scale = moments.rough_scales(cube, record, list(moments.QUANTITIES.values()))
    read = Reader([cube[name] for name in FIELDS], record)
    chain = _Chain(read, welch, scale, requested, max(1, record.steps_in_runs() // SAMPLED_STEPS))
    chains = cut_chains(record, welch.segment)
    total = Sums()
    for done, part in enumerate(each(chain, chains), 1):
        total = total + part
        if progress:
            progress(done, len(chains))
    return vars(total) | {"scale": scale, "point_series": np.concatenate(total.points)}


# Each thread holds half segments of all fields: .3 GB for 100 x 130 nodes, and 3.4 GB in all with eight.
THREADS = 2


def analyze(
    cube: xr.Dataset,
    *,
    progress: Progress | None = None,
    each: Each | None = None,
    probes: xr.Dataset | None = None,
    segment: int | None = None,
    depth: float | None = None,
    gain: str | Path | xr.Dataset | Literal[False] | None = None,
    current: tuple[float, float] | None = None,
) -> xr.DataTree:
    """Compute all wave products of an open cube, as `wavefield.analyze` does, but write no store.

    Parameters
    ----------
    cube : Dataset
        z (m), z_t, u, v, w (m/s) over (time, y, x).
    progress : callable, optional
        Called with the number of parts done and the number of all parts.
    each : callable, optional
        ``each(work, items)`` yields ``work(item)`` for every item, in order; by default in two threads.
    probes, segment, depth, gain, current : optional
        As in `wavefield.analyze`: wave probes, steps of a Welch segment, water depth (m), amplitude gains of
        the measurement, and velocity of the water along x and y (m/s) if it cannot be fitted.

    Returns
    -------
    DataTree
        One group per kind of product, such as ``spectra`` and ``coherence``.

    Raises
    ------
    CubeError
        If the cube lacks a variable, is too short or too small, or if the probes were not recording.
    StoreError
        If the gain cannot be read.

    Examples
    --------
    >>> from wavefield import open_cube, waves
    >>> waves.analyze(open_cube("sea.zarr"))["spectra"].E.dims
    ('quantity', 'omega', 'k')
    """
    if not isinstance(cube, xr.Dataset):
        raise CubeError(f"analyze needs a cube, got {described(cube)}: give the cube itself")
    complete = with_stated(cube)
    for name in FIELDS:
        if name not in complete:
            raise CubeError(
                f"the cube has no {name!r}: the analysis needs {', '.join(FIELDS)} over time, y and x"
            )
    fields = validate(complete, *FIELDS)
    threads = min(THREADS, dask.config.get("num_workers", None) or THREADS)
    with np.errstate(all="ignore"), dask.config.set(num_workers=threads):
        depth, gamma = water_of(complete.attrs, depth)
        given = {
            "cube": fields,
            "complete_cube": complete,
            "each": each,
            "depth": depth,
            "gamma": gamma,
            "gain": gain_of(complete, gain),
            "probes": probes,
            "given_current": current,
        }
        status = {name: complete[name] for name in ("frame_status", "quality") if name in complete}
        record = find_record(fields.assign(status), each=each)
        return _analyze(given, record, segment, progress)


def _analyze(
    given: Mapping[str, Any], record: Record, segment: int | None, progress: Progress | None
) -> xr.DataTree:
    cube, each = given["cube"], given["each"]
    welch = Welch.of(cube, segment, record)
    mean, mean_std = dask.compute(delayed_current(cube, record))[0]
    welch = replace(welch, current=(float(mean[0]), float(mean[1])), depth=given["depth"])
    registered = products.registered()
    pairs = tuple(dict.fromkeys(pair for product in registered for pair in product.pairs))
    planes = tuple(dict.fromkeys(plane for product in registered for plane in product.planes))
    filled = {name: filled_density(record, cube[name]) for name in ("z", "w")}
    values = {**given, "filled": filled, "welch": welch, "mean_current": (mean, mean_std), "pairs": pairs}
    waiting = list(registered)
    notes = products.compute_ready(waiting, values, each)  # finds mistakes before the long pass
    values |= one_pass(cube, welch, Requested(NAMES, pairs, planes), progress, each or _in_threads)
    notes |= products.compute_ready(waiting, values, each)

    order = list(GROUPS)
    stored = [product for product in registered if product.group]
    stored.sort(key=lambda p: (order.index(p.group) if p.group in order else len(order), p.name != p.group))
    groups: dict[str, xr.Dataset] = {}
    text = record_notes(welch, cube, given["depth"])
    if not states_velocity(given["complete_cube"]):
        text.append(
            "The cube does not state what its velocities are: displacements over one step were assumed (give"
            " it the attribute velocity='instantaneous' for those of a model)."
        )
    for product in stored:
        text += notes.get(product.name, [])
        if product.name in values:
            value, group = values[product.name], product.group
            groups[group] = groups[group].assign(value.data_vars) if group in groups else value
    attrs = _attributes(given, welch) | {"notes": "\n".join(text)}
    return xr.DataTree.from_dict(
        {"/": xr.Dataset(attrs=attrs)} | {f"/{name}": annotate(group, name) for name, group in groups.items()}
    )


def _attributes(given: Mapping[str, xr.Dataset], welch: Welch) -> dict[str, Any]:
    cube, complete, record = given["cube"], given["complete_cube"], welch.record
    depth, gain = given["depth"], given["gain"]
    return {
        "title": "waves of a cube",
        "source": str(complete.attrs.get("experiment", complete.encoding.get("source", ""))),
        "frame_rate": 1 / record.dt,
        "water_depth": depth if np.isfinite(depth) else "deep",
        "surface_tension_over_density": given["gamma"],
        "windows_undone": "no" if gain is None else str(gain.attrs.get("origin", "yes")),
        "segment": welch.segment,
        "segments": welch.count,
        "frames_of_velocities": welch.frames,
        "degrees_of_freedom": welch.dof,
        "steps": record.steps,
        "steps_used": record.steps_in_runs(welch.segment),
        "steps_bridged": len(record.bridged),
        "nodes_filled": record.holes,
        "runs": len(record.runs),
        "x": [float(cube["x"][record.x[0]]), float(cube["x"][record.x[1] - 1])],
        "y": [float(cube["y"][record.y[0]]), float(cube["y"][record.y[1] - 1])],
        "wavefield_version": wavefield.__version__,
    }


FEW_SEGMENTS = 7  # the default segment is a quarter of the record and gives seven


def record_notes(welch: Welch, cube: xr.Dataset, depth: float) -> list[str]:
    """Return sentences for the user on the part of a cube that was analysed and on interpolated gaps."""
    record, count, sizes = welch.record, welch.count, cube.sizes
    used = record.steps_in_runs(welch.segment)
    out = []
    if count < FEW_SEGMENTS:
        out.append(
            f"The record holds {count} segment{'s' if count > 1 else ''} of"
            f" {welch.segment * record.dt:.3g} s: a single cell has {welch.dof:.1f} degrees of freedom,"
            " so trust averages over rings and bands, not single values."
        )
    if used < record.steps:
        out.append(
            f"{record.steps - used} of {record.steps} steps are missing or in pieces too short for a segment."
        )
    if record.bridged:
        out.append(
            f"{len(record.bridged)} missing steps in short gaps were bridged by interpolation in time."
        )
    if record.holes:
        out.append(_note_on_holes(record, cube["z"]))
    if record.shape != (sizes["y"], sizes["x"]):
        out.append(
            f"Of {sizes['y']} x {sizes['x']} nodes (y, x) the largest full rectangle was used,"
            f" {record.shape[0]} x {record.shape[1]}."
        )
    if not np.isfinite(depth):
        out.append("The depth of the water is not known to the cube: deep water was assumed.")
    return out


def _note_on_holes(record: Record, z: xr.DataArray) -> str:
    """Return a sentence on interpolated nodes: their number, the error of z and what it adds to E(omega)."""
    share = record.holes / (record.steps_in_runs() * record.shape[0] * record.shape[1])
    text = f"{record.holes} missing nodes ({100 * share:.2g} %) were filled from their neighbours"
    error = filled_error(record, z)
    if not np.isfinite(error):
        return f"{text}."
    return (
        f"{text}, with an error of {1e3 * error:.2g} mm (found on nodes that are there): it adds up to"
        f" {2 * record.dt * share * error**2:.1g} m2/Hz to the spectrum of the elevation. Lines with"
        " less than four times that are not valid."
    )
