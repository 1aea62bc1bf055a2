"""The analysis of one cube: all registered products.

The store that `wavefield.analyze` writes of it is a Zarr hierarchy;
``xarray.open_datatree(path, engine="zarr")`` reads it without this package. Its groups and variables are
those of `wavefield.variables`, listed on the documentation's page on waves.

Conventions. k points where the wave goes: f = Re sum F exp(i (k . x - omega t)), omega > 0. Spectra are
densities in rad/m and rad/s, one-sided in omega, so that the sum of E over its axes times the cell is the
variance. Coordinates: ``omega`` (rad s-1) with ``frequency`` (Hz), ``k`` (rad m-1, centres of rings) with
``cycles`` (m-1), ``kx`` and ``ky`` (rad m-1). Intervals are factors: the truth is in [low E, high E] with
95 % confidence. ``valid`` masks show where a spectrum can be trusted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

import dask
import numpy as np
import xarray as xr

import wavefield
from wavefield.errors import CubeError
from wavefield.variables import GROUPS, annotate, validate
from wavefield.water import water_of
from wavefield.waves import products
from wavefield.waves.estimation import segments
from wavefield.waves.estimation.current import delayed_current
from wavefield.waves.estimation.inputs import described
from wavefield.waves.estimation.record import Each, Record, filled_density, find_record
from wavefield.waves.estimation.record_limits import record_notes
from wavefield.waves.estimation.welch import Welch, with_velocity
from wavefield.waves.estimation.window_gain import gain_of
from wavefield.waves.estimators.cross_spectra import NAMES, Requested
from wavefield.waves.onepass import FIELDS, Progress, one_pass

MAP_FREQUENCIES = (1.5, 2.0, 2.8, 4.0)  # Hz; 2.8 is the paper's


class AnalysisOptions(TypedDict, total=False):
    """What of an analysis can be chosen; all of it is optional."""

    probes: xr.Dataset | None
    segment: int | None
    depth: float | None
    velocity: Literal["instantaneous", "displacement"] | None
    pixel_size: float | None
    gain: str | Path | xr.Dataset | Literal[False] | None
    fit: object
    maps: Sequence[float]


def analyze(
    cube: xr.Dataset,
    *,
    progress: Progress | None = None,
    each: Each | None = None,
    **options: Unpack[AnalysisOptions],
) -> xr.DataTree:
    """Compute all wave products of a cube that is in memory or opened lazily.

    Parameters
    ----------
    cube : Dataset
        z, z_t, u, v, w over (time, y, x), m and m/s.
    progress : callable, optional
        Called with the parts done and all parts.
    each : callable, optional
        Does the work on workers, as in `wavefield.analyze`.
    **options
        As in `wavefield.analyze`, which also opens stores and writes the result.

    Returns
    -------
    DataTree
        One group for each subject.

    Raises
    ------
    CubeError
        If the cube lacks a variable, is shorter than a segment, has uneven steps or no full rectangle.
    """
    unknown = options.keys() - AnalysisOptions.__annotations__
    if unknown:
        raise TypeError(f"analyze() has no option {', '.join(sorted(unknown))}")
    gain = options.get("gain")
    if not isinstance(cube, xr.Dataset):
        raise CubeError(f"analyze needs a cube, got {described(cube)}: give the cube itself")
    complete, unstated = with_velocity(cube, options.get("velocity"))
    for name in FIELDS:
        if name not in complete:
            raise CubeError(
                f"the cube has no {name!r}: the analysis needs {', '.join(FIELDS)} over time, y and x"
            )
    fields = validate(complete, *FIELDS)
    with np.errstate(all="ignore"):
        depth, gamma = water_of(complete.attrs, options.get("depth"))
        given = {
            "cube": fields,
            "complete_cube": complete,
            "each": each,
            "depth": depth,
            "gamma": gamma,
            "pixel_size": options.get("pixel_size") or complete.attrs.get("pixel_size"),
            "gain": gain_of(complete, gain),
            "probes": options.get("probes"),
            "fit": options.get("fit"),
            "map_frequencies": options.get("maps", MAP_FREQUENCIES),
        }
        status = {name: complete[name] for name in ("frame_status", "quality") if name in complete}
        # a cube has all fields where it has z: the pass checks that, so the others need not be read twice
        try:
            record = find_record(fields[["z"]].assign(status), each=each)
            tree = _analyze(given, record, options.get("segment"), True, progress)
        except segments.UnlikeFirst:
            record = find_record(fields.assign(status), each=each)
            tree = _analyze(given, record, options.get("segment"), False, progress)
    if unstated:
        tree.attrs["notes"] = "\n".join(filter(None, [tree.attrs["notes"], unstated]))
    return tree


def _analyze(
    given: Mapping[str, Any], record: Record, segment: int | None, alike: bool, progress: Progress | None
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
    notes = products.compute_ready(waiting, values, each)  # mistakes are found before the long pass
    values |= vars(one_pass(cube, welch, alike, Requested(NAMES, pairs, planes), progress, each))
    notes |= products.compute_ready(waiting, values, each)

    order = list(GROUPS)
    stored = [product for product in registered if product.group]
    stored.sort(key=lambda p: (order.index(p.group) if p.group in order else len(order), p.name != p.group))
    groups: dict[str, xr.Dataset] = {}
    text = record_notes(welch, cube, given["depth"])
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
