"""Assess a cube: remarks on its faults, errors of each pair of cameras, terms of standard uncertainties.

All remarks on a cube together are its verdict. A step is the interval between two consecutive frames.
"""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import WavefieldError
from wavefield.execution.cluster import threads_here
from wavefield.execution.process import one_opencv_thread
from wavefield.measurement.diagnostics import Diagnosis, diagnose, rms_within
from wavefield.measurement.error_budget import fast_waves, ripples
from wavefield.pipeline.chunk import make_chunk, measure_chunk
from wavefield.pipeline.learning import both_frames, learn_record, samples
from wavefield.pipeline.prepare import SAMPLE_STEPS, PreparedRun, expected_coverage, prepare
from wavefield.quality import camera_motion, cameras, record, remarks
from wavefield.rig import Rig
from wavefield.rig.field import pixel_size
from wavefield.sampling import evenly_spaced
from wavefield.series import Experiment, FrameSeries
from wavefield.store.cube import open_cube
from wavefield.store.ledger import Status
from wavefield.store.read import open_group
from wavefield.store.recipe import state_of
from wavefield.store.results import read_pair_statistics, write_pair_statistics
from wavefield.store.verdict import Remark, Verdict
from wavefield.store.write_cube import clear_steps
from wavefield.variables import FrameStatus, Quality

MAX_SAMPLED = 12  # steps of a cube that are assessed after its run


def compare_cameras(prepared: PreparedRun, quality: NDArray[np.uint16]) -> Verdict:
    """Compare the images of the cameras at a few frames of the record, and return remarks on their faults.
    ``quality`` (n, ny, nx) holds bit flags of the cube at some steps. If most nodes were measured with all
    cameras, remarks that a camera matches no other are left out."""
    count = prepared.steps + 1
    matcher = cameras.PatchMatcher(prepared.read_uncovered, prepared.rig, prepared.grid)
    frames = evenly_spaced(count, SAMPLE_STEPS)
    with one_opencv_thread():  # in each of our threads
        found = cameras.find_camera_faults(matcher, count, frames, threads_here(prepared.workflow))
    # patches may not match with a correct rig: in waves that are higher or steeper than the search allows, or
    # in a light sheet that spans several pixels of parallax
    measured = fraction_measured(quality, by_all=True) > 0.5
    ignored = ("disagree",) if prepared.in_light_sheet else cameras.INCONSISTENT if measured else ()
    return replace(found, remarks=tuple(one for one in found.remarks if one.kind not in ignored))


def measure_synchrony(
    prepared: PreparedRun, cube: xr.Dataset, frames: Sequence[int], first: int = 0
) -> camera_motion.Synchrony:
    """Measure the delays between the cameras at some frames, from the images and the velocities of a cube.
    ``frames`` are indices in the record. ``cube`` holds u, v, w and quality of the steps before and after
    these frames; its first step is the step ``first`` of the record."""
    rate, read = prepared.frame_rate, prepared.read_uncovered

    def displacement(k: int) -> NDArray[np.floating]:
        around = cube[["u", "v", "w", "quality"]].isel(time=slice(k - 1 - first, k + 1 - first)).load()
        measured = (around.quality & int(Quality.MEASURED)) != 0
        moved = around[["u", "v", "w"]].where(measured).mean("time", skipna=False) / rate
        return np.asarray(moved.to_dataarray().values)

    if prepared.record is None:
        return camera_motion.Synchrony({})
    with one_opencv_thread():  # in each of our threads
        threads = threads_here(prepared.workflow)
        return camera_motion.delays(
            prepared.geometry, prepared.record, frames, read, displacement, rate, threads
        )


def clear_discontinuous_steps(prepared: PreparedRun, status: Status) -> None:
    """Set to NaN the steps of a stored cube that use frames from both sides of a lost, doubled or late frame.
    A cube that is incomplete or measured in a light sheet is not changed. A second call changes nothing."""
    if not status.complete or prepared.in_light_sheet:
        return
    cube = open_cube(status.store)
    jumps = record.discontinuous_steps(*record.rise_ratios(cube))
    found = record.steps_to_leave_out(jumps, cube.sizes["time"])
    cleared = np.union1d(found, np.flatnonzero(cube.frame_status.values == FrameStatus.DISCONTINUOUS))
    if cleared.size:
        clear_steps(status.store, cleared.tolist())


def assess_run(prepared: PreparedRun, status: Status) -> Verdict:
    """Return the verdict on the cube of a run: remarks on cameras, frames, probes, fields and short waves."""
    experiment, series = prepared.experiment, prepared.series
    cube = open_cube(status.store)
    sample = cube[[*record.COMPARED, "eps_piv", "quality"]]
    sample = sample.isel(time=evenly_spaced(status.steps, MAX_SAMPLED)).load()
    faults = compare_cameras(prepared, sample.quality.values)
    kept = [*faults.remarks]
    if faults.weight != "grave":
        frames = [1 + k for k in _sampled(prepared.steps - 1)]
        kept += camera_motion.remarks_on_clocks(measure_synchrony(prepared, cube, frames))
        kept += camera_motion.remarks_on_mounts(cube)
    kept += [
        remarks.remark_on_rest(experiment, prepared.rig, float(cube.get("z_level_std", np.nan))),
        *record.remark_on_recordings(experiment, series),
        *remarks.remark_on_probes(experiment, cube, record_span(experiment, series)),
        *remarks.remark_on_steps(status),
        *remarks.remark_on_coverage(expected_coverage(prepared.rig, prepared.grid)),
        *remarks.remark_on_cameras_left_out(sample.quality.values, sample.attrs["cameras"]),
        *remarks_on_fields({str(name): one.values for name, one in sample.items()}),
        *(() if prepared.in_light_sheet else record.remark_on_kinematics(sample)),
        *record.remark_on_cleared_steps(cube),
        *_short_waves(sample, prepared),
    ]
    return Verdict(kept, faults.pairs, faults.frames)


def record_span(experiment: Experiment, series: Mapping[str, FrameSeries]) -> tuple[float, float]:
    """Return the times of the first and last frame of the record, s; ``series`` holds frames by camera."""
    times = experiment.frame_times(next(iter(series.values())))
    return float(times[0]), float(times[-1])


def _short_waves(sample: xr.Dataset, prepared: PreparedRun) -> Iterator[Remark]:
    """Yield remarks on waves that are too fast for the frame rate or too short for the images.
    ``sample`` holds w and quality of some steps."""
    record, measured = prepared.record, sample.quality.values & int(Quality.MEASURED) != 0
    if record is None or not measured.any():
        return
    rate, (_, wavelength) = prepared.frame_rate, record.ripples
    aliased = (
        f"They are aliased at {rate:.3g} Hz: their velocities are not resolved, and the standard "
        "uncertainties may be too small. Longer waves are not affected"
    )
    fast = fast_waves(record.elevation, prepared.geometry.pixel, rate)
    yield from remarks.remark_on_unresolved_waves(*fast, aliased, "At least double the frame rate")
    if not all(record.ripples):
        return
    unresolved = float(ripples(record.ripples, rate)[3]) * rate**2
    fraction = unresolved / (unresolved + float(np.mean(np.square(sample.w.values[measured]))))
    missing = (
        "The images do not resolve them: they are missing in w, and its standard uncertainty includes "
        f"{1e3 * np.sqrt(unresolved):.3g} mm/s for them. Longer waves are not affected"
    )
    remedy = "Record smaller pixels on the water to measure them"
    yield from remarks.remark_on_unresolved_waves(fraction, wavelength, missing, remedy)


def remarks_on_fields(fields: Mapping[str, NDArray[Any]]) -> Iterator[Remark]:
    """Yield remarks on errors and holes in ``fields``: z, eps_piv and quality, each (n, ny, nx)."""
    if not np.isfinite(fields["z"]).any():
        return  # failed steps have a remark of their own
    yield from remarks.remark_on_eps_piv(fields["z"], fields["eps_piv"])
    yield from remarks.remark_on_holes(fraction_measured(fields["quality"]))


def fraction_measured(quality: np.ndarray, by_all: bool = False) -> float:
    """Return the fraction of the nodes in view that were measured; 0 if no node is in view.
    With ``by_all``, nodes measured without some camera do not count. ``quality`` holds bit flags."""
    visible = (quality & (Quality.OUTSIDE | Quality.MASKED)) == 0
    marks = np.uint16(Quality.MEASURED | (Quality.FEWER_CAMERAS if by_all else 0))
    return float(((quality[visible] & marks) == Quality.MEASURED).mean()) if visible.any() else 0.0


def _sampled(steps: int) -> list[int]:
    """Return the indices of evenly spaced steps of a record of ``steps`` steps, to assess its cameras.
    The number of indices is a tenth of all steps, but at least 4 and at most 12."""
    return evenly_spaced(steps, min(MAX_SAMPLED, max(SAMPLE_STEPS, steps // 10)))


_BIN_EDGES = np.linspace(-5, 5, 101)  # errors in units of their rms


def pair_statistics(prepared: PreparedRun) -> xr.Dataset | None:
    """Measure some steps with each pair of cameras alone, and return statistics of errors between cameras.
    Returns ``rms`` and ``beyond`` (fraction of outliers), each (error,), and ``density`` (error, bin), the
    probability density of each error divided by its rms. Coordinates give the quantity, cameras and units of
    an error. None if no step can be measured, if nothing was learned from the record, or in a light sheet."""
    geometry, model = prepared.geometry, prepared.model
    if prepared.in_light_sheet or model is None:  # cameras are not matched with each other
        return None
    pixel = pixel_size(prepared.rig, prepared.grid)

    def diagnosed(step: int) -> Diagnosis | None:
        both = (step, step + 1)
        first, second = both_frames(samples(prepared.series, [step])[0])
        frames = {name: [first[name], second[name]] for name in first}
        masks = {n: [one.covered(k) for k in both] for n, one in prepared.series.items()}
        try:
            return diagnose(frames, geometry, model, masks)
        except ValueError:  # a frame is missing or bad
            return None

    steps = _sampled(prepared.steps)
    with one_opencv_thread(), ThreadPoolExecutor(threads_here(prepared.workflow)) as pool:
        found = {step: one for step, one in zip(steps, pool.map(diagnosed, steps)) if one is not None}
    if not found:
        return None
    quantities, cameras, units, _ = zip(*next(iter(found.values())).errors())
    each = zip(*([values for *_, values in one.errors()] for one in found.values()))
    errors = [np.concatenate([values.ravel() for values in one]) for one in each]
    finite = [values[np.isfinite(values)] for values in errors]
    rms, beyond = zip(*(rms_within(values) for values in finite))
    return xr.Dataset(
        {
            "rms": ("error", np.array(rms)),
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


def _density(values: NDArray[np.float64], rms: float) -> NDArray[np.float64]:
    """Return the probability density of values / rms in the bins `_BIN_EDGES`; all 0 if rms is 0 or NaN."""
    if not rms > 0:
        return np.zeros(_BIN_EDGES.size - 1)
    counts, _ = np.histogram(values / rms, _BIN_EDGES)
    return np.asarray(counts / (values.size * np.diff(_BIN_EDGES)))


def store_pair_statistics(prepared: PreparedRun, path: Path) -> None:
    """Write the result of `pair_statistics` into the store ``path`` of a complete cube.
    Nothing is done if the store already has the result for its present values."""
    group = open_group(path)
    state = state_of(group)
    stored = read_pair_statistics(path)
    if stored is None or stored.attrs["cube_state"] != state:
        statistics = pair_statistics(prepared)
        if statistics is not None:
            write_pair_statistics(path, statistics, state)


def uncertainty_terms(
    experiment: str | Path | Experiment,
    step: int | None = None,
    rig: str | Path | Rig | None = None,
) -> xr.Dataset:
    """Return the terms of the standard uncertainties of z, u, v and w at one step.

    Terms are standard uncertainties, too: the sum of their squares is the variance.

    Parameters
    ----------
    experiment : path or Experiment
        Experiment file, or the experiment. Its images are measured; a cube is not needed.
    step : int, optional
        Index of the step in the record, from 0; by default the middle step.
    rig : path or Rig, optional
        Used instead of the rig that the experiment names.

    Returns
    -------
    Dataset, (term, y, x)
        z in m; u, v, w in m/s; NaN where not measured. The coordinate ``term`` has the values

        - ``noise``: image noise; for u, v, w larger where displacements seen by the cameras disagree;
        - ``prior``: waves that the prior of the estimator damps;
        - ``frames``: waves too fast for the frame rate;
        - ``ripples``: waves shorter than an interrogation block;
        - ``setup``: epipolar error, height of beads, light sheet.

    Raises
    ------
    WavefieldError
        If the record has no such step, none of its sample frames can be measured, or an input is wrong.

    Examples
    --------
    >>> import tempfile
    >>> from wavefield.tank import Scene, simulate
    >>> scene = Scene.load("demo").with_(rig={"crop": 0.15}, frames=6, sea={"shortest": 0.15})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     terms = uncertainty_terms(simulate(scene, folder), rig=scene.build_rig())
    >>> terms.term.values.tolist()
    ['noise', 'prior', 'frames', 'ripples', 'setup']
    >>> rms = (terms.z**2).mean(("y", "x")) ** 0.5
    >>> bool(rms.sel(term="noise") > rms.sel(term="frames"))
    True
    """
    from wavefield.measurement.error_budget import TERMS

    prepared = prepare(experiment, rig)
    step = prepared.steps // 2 if step is None else step
    if not 0 <= step < prepared.steps:
        raise WavefieldError(f"step {step}: the record has steps 0 to {prepared.steps - 1}")
    rate, geometry = prepared.frame_rate, prepared.geometry
    prepared = prepared.with_prior(learn_record(prepared.series, prepared.steps, geometry, rate))
    if prepared.model is None:
        raise WavefieldError(f"{prepared.experiment.path}: none of the sample frames can be measured")
    chunk = make_chunk(prepared.series, step, step + 1, prepared.departures)
    with one_opencv_thread():
        found = measure_chunk(chunk, geometry, rate, prepared.model, terms=True)
    terms = found.fields["uncertainty_terms"][0]
    scale = {"z": 1.0, "u": rate, "v": rate, "w": rate}
    units = {name: {"units": "m" if name == "z" else "m s-1"} for name in scale}
    return xr.Dataset(
        {n: (("term", "y", "x"), terms[:, i] * k, units[n]) for i, (n, k) in enumerate(scale.items())},
        {"term": list(TERMS), "y": prepared.grid.y_nodes, "x": prepared.grid.x_nodes},
        {"step": step},
    )
