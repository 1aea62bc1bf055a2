"""Errors of every pair of cameras on its own, at sampled steps of a record: no truth needed."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.execution.cluster import threads_here
from wavefield.execution.process import one_thread
from wavefield.measurement import GridGeometry, LearnedRecord, Model, diagnose, pooled, sample_steps
from wavefield.measurement.diagnostics import Diagnosis, joined, rms_within
from wavefield.pipeline.learning import both_frames, learn_from, samples
from wavefield.pipeline.prepare import PreparedRun
from wavefield.rig.field import pixel_size
from wavefield.sampling import from_first_to_last
from wavefield.store.camera_pairs import read_pair_statistics, write_pair_statistics
from wavefield.store.read import open_group
from wavefield.store.recipe import cube_state

MAX_STEPS = 8
STEPS_PER_SAMPLE = 12  # of a short record, so that this is not most of its cost
_BIN_EDGES = np.linspace(-5, 5, 101)  # rms


def pair_statistics(prepared: PreparedRun) -> xr.Dataset | None:
    """Errors of pairs of cameras, each measured alone at some steps; None where no step can be.

    Returns rms, rms_all, beyond (error,), density (error, bin), with the coordinates quantity, cameras and
    units (error,): ``eps_y``, ``sigma_z``, ``eps_piv`` of pairs; ``z``, ``dx``, ``dy``, ``dz`` of one pair
    minus another; ``z_recombined``, z of a direct pair recombined from two minus z measured directly.
    """
    if prepared.geometry.settings.sheet_thickness is not None:  # its cameras are not matched with each other
        return None
    geometry = _with_every_motion(prepared.geometry)
    model = _learned(prepared, geometry)
    if model is None:
        return None
    pixel = pixel_size(prepared.rig, prepared.grid)

    def diagnosed(step: int) -> Diagnosis | None:
        both = (step, step + 1)
        first, second = both_frames(samples(prepared.series, [step])[0])
        frames = {name: [first[name], second[name]] for name in first}
        masks = {n: [one.covered(k) for k in both] for n, one in prepared.series.items()}
        try:
            return diagnose(frames, geometry, model, pixel, masks)
        except ValueError:  # a frame is missing or bad
            return None

    steps = from_first_to_last(prepared.steps, min(MAX_STEPS, -(-prepared.steps // STEPS_PER_SAMPLE)))
    with one_thread(), ThreadPoolExecutor(threads_here(prepared.workflow)) as pool:
        found = {step: one for step, one in zip(steps, pool.map(diagnosed, steps)) if one is not None}
    if not found:
        return None
    quantities, cameras, units, errors = zip(*_errors(pooled(list(found.values()))))
    finite = [values[np.isfinite(values)] for values in errors]
    rms, beyond = zip(*(rms_within(values) for values in finite))
    return xr.Dataset(
        {
            "rms": ("error", np.array(rms)),
            "rms_all": ("error", [float(np.sqrt(np.mean(v**2))) if v.size else np.nan for v in finite]),
            "beyond": ("error", np.array(beyond)),
            "density": (("error", "bin"), [_density(v, one) for v, one in zip(finite, rms)]),
        },
        {
            "bin": (_BIN_EDGES[1:] + _BIN_EDGES[:-1]) / 2,
            "quantity": ("error", list(quantities)),
            "cameras": ("error", list(cameras)),
            "units": ("error", list(units)),
        },
        {"pixel_size": pixel, "steps": list(found)},
    )


def _with_every_motion(geometry: GridGeometry) -> GridGeometry:
    """The same with the motion in every camera's images, not only in those that give the velocity."""
    settings = replace(geometry.settings, velocity_cameras=geometry.cameras)
    return GridGeometry(geometry.rig, geometry.grid, settings, geometry.covered)


def _learned(prepared: PreparedRun, geometry: GridGeometry) -> Model | None:
    """What one sampled step gives of the record; a run learns without cameras that give no velocity."""
    steps = prepared.recipe.record.get("steps", sample_steps(prepared.steps))
    for pair in samples(prepared.series, steps):
        if record := learn_from(
            [pair], geometry, prepared.experiment.frame_rate, threads_here(prepared.workflow)
        ):
            return Model(geometry, LearnedRecord.from_dict(record))
    return None


def _errors(found: Diagnosis) -> Iterator[tuple[str, str, str, NDArray[np.float64]]]:
    """Quantity, cameras, units and samples of every error."""
    for pair, values in found.eps_y.items():
        yield "eps_y", joined(pair), "m", values
        yield "sigma_z", joined(pair), "m", np.array([found.z_std[pair]])
    for one, other in combinations(found.z, 2):
        yield "z", f"{joined(one)} minus {joined(other)}", "m", found.z[one] - found.z[other]
    for pair, values in found.recombined.items():
        yield "z_recombined", joined(pair), "m", values
    for cameras, values in found.eps_piv.items():
        yield "eps_piv", joined(cameras), "pixel", values
    for (one, other), moved in found.moved_difference.items():
        for name, values in zip(("dx", "dy", "dz"), np.moveaxis(moved, -3, 0)):
            yield name, f"{joined(one)} minus {joined(other)}", "m", values


def _density(values: NDArray[np.float64], rms: float) -> NDArray[np.float64]:
    """Probability density of finite values over their rms, (bins,)."""
    if not rms > 0:
        return np.zeros(_BIN_EDGES.size - 1)
    counts, _ = np.histogram(values / rms, _BIN_EDGES)
    return np.asarray(counts / (values.size * np.diff(_BIN_EDGES)))


def store_pair_statistics(prepared: PreparedRun, path: Path) -> None:
    """Put the statistics into a cube whose run has ended, unless those of the same ledger are there."""
    group = open_group(path)
    state = cube_state(group.attrs, group["frame_status"][:])
    stored = read_pair_statistics(path)
    if stored is None or stored.attrs["cube_state"] != state:
        statistics = pair_statistics(prepared)
        if statistics is not None:
            write_pair_statistics(path, statistics, state)
