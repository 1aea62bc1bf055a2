"""What sample frames show of a whole record: beads, spectra, noise. Once per run, before its first step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.images import made_even
from wavefield.matching import Modes, Prior
from wavefield.matching.matching_kernels import BLOCK
from wavefield.matching.one_thread import one_thread
from wavefield.measurement import elevation
from wavefield.measurement.background import bead_width
from wavefield.measurement.common_waves import CommonWaves, OpenField, common_waves
from wavefield.measurement.differences import Differences, differences, typical_differences
from wavefield.measurement.field_samples import (
    DisplacementSample,
    ElevationSample,
    FieldSample,
    FieldSamples,
    OpenFields,
)
from wavefield.measurement.flow import FlowEstimate, camera_flow, map_displacement, motion_variance
from wavefield.measurement.frame import usable
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.instant import Images, images_of
from wavefield.measurement.learned_record import LearnedRecord
from wavefield.measurement.masked import Masks, bare_of_camera, bare_of_pairs
from wavefield.measurement.model import Model
from wavefield.measurement.temporal_truncation import (
    TemporalTruncation,
    detected_waves,
    temporal_truncation,
)
from wavefield.measurement.unresolved_waves import in_common, stated_rise

Frames = Mapping[str, NDArray[Any] | None]
Float = NDArray[np.floating]

SAMPLES = 4  # steps of a record
_MIN_INFORMATION = 1e-3  # of a block, per square px: its own estimate is uncertain by 30 px
_SLOW_FLOW = 0.25  # nodes per step: slower water leaves the phases of waves nearly as they are
_NOISE_FACTORS = 0.1, 10.0  # accepted range
_FLAT = Prior.isotropic((0.0, np.pi), (1e-12, 1e-12), 1.0)  # of a light sheet: no waves


def sample_steps(count: int, number: int = 0) -> list[int]:
    """Steps of a record from which its spectra and noise are learned.

    Parameters
    ----------
    count : int
        Steps of the record.
    number : int, default 0
        Which set: others where the first cannot be measured.

    Returns
    -------
    list of int
        At most four, evenly over the record.

    Examples
    --------
    >>> sample_steps(100), sample_steps(100, 1), sample_steps(2)
    ([12, 37, 62, 87], [20, 45, 70, 95], [0, 1])
    """
    requested = min(count, SAMPLES)
    return [int((i + 0.5 + number / 3) * count / requested) % count for i in range(requested)]


@one_thread()
def learn(
    steps: Sequence[tuple[Frames, Frames]],
    geometry: GridGeometry,
    masks: Sequence[tuple[Masks, Masks]] | None = None,
    threads: int = 1,
    frame_rate: float | None = None,
) -> LearnedRecord | None:
    """Learn a record's beads, spectra and noise from sample frames.

    Parameters
    ----------
    steps : sequence of (mapping, mapping)
        First and second frame of some steps (`sample_steps`), per camera; None where absent.
    geometry : GridGeometry
        Rig, grid and settings.
    masks : sequence of (mapping, mapping), optional
        True where pixels of these frames do not count, per camera; None where all do.
    threads : int, default 1
        Steps that are computed in parallel; the result does not depend on it.
    frame_rate : float, optional
        Frames per second, Hz; without it, waves below the noise of z are not known from displacements.

    Returns
    -------
    LearnedRecord or None
        For a `Model`; None if none of the frames can be measured.

    Notes
    -----
    The first spectrum is that of windowed fields over the windows' gain; then fields and spectra
    follow from each other (`better_prior`). The noise of the displacements is such that the median of the
    cameras' misfit is that of chi^2.
    """
    with ThreadPoolExecutor(threads) as pool:
        return _learned(steps, geometry, masks or [({}, {})] * len(steps), pool, frame_rate)


@dataclass(frozen=True)
class _SampleStep:
    """One step with what matching finds, whatever the prior."""

    first: Images
    second: Images
    pairs: elevation.MatchedPairs | None  # at the first frame
    displacements: Mapping[str, matching.Displacement]

    @classmethod
    def match(
        cls,
        geometry: GridGeometry,
        beads: Mapping[str, float],
        frames: tuple[Frames, Frames],
        masks: tuple[Masks, Masks],
    ) -> _SampleStep:
        """Prepare and match the images of a step."""
        first, second = (images_of(*one) for one in zip(frames, [geometry] * 2, [beads] * 2, masks))
        found = {
            name: matching.match(first.raw[name], second.raw[name], geometry.settings.piv)
            for name in first.raw
            if name in second.raw
        }
        return cls(first, second, elevation.match_pairs(first.flat, geometry), found)


def _learned(
    steps: Sequence[tuple[Frames, Frames]],
    geometry: GridGeometry,
    masks: Sequence[tuple[Masks, Masks]],
    pool: ThreadPoolExecutor,
    frame_rate: float | None,
) -> LearnedRecord | None:
    beads = _bead_widths(steps, masks, geometry, pool)
    samples = list(pool.map(partial(_SampleStep.match, geometry, beads), steps, masks))
    heights = _learn_elevation(samples, geometry, pool)
    by_camera = {
        name: _learn_displacement(name, samples, beads.get(name, 0.0), geometry, pool)
        for name in geometry.velocity_cameras
    }
    measured = {name: fields for name, fields in by_camera.items() if fields is not None}
    prior = _elevation_prior(heights) if heights else _FLAT
    if len(measured) < 2 or not (heights or geometry.settings.sheet_thickness is not None):
        return None
    some = next(iter(measured.values()))
    priors = {name: measured.get(name, some).prior for name in geometry.velocity_cameras}
    record = LearnedRecord(tuple(beads.items()), prior, tuple(priors.items()), (1.0, 1.0, 1.0))
    model = Model(geometry, record)
    flow = np.mean([_mean_flow(step, geometry) for step in samples], axis=0)
    current = bool(np.hypot(*flow) > _SLOW_FLOW * geometry.grid.step)
    surfaces = list(pool.map(partial(_elevations, geometry, model, current), samples))
    truncation = partial(_truncation, surfaces, prior, record, geometry, frame_rate if heights else None)
    record = replace(record, temporal_truncation=truncation(prior))
    unresolved = []
    for number in range(2):
        if number:
            model = Model(geometry, record, model)
        each = pool.map(partial(_differences, geometry, model), samples, surfaces)
        found = typical_differences([one for one in each if one is not None], geometry.pixel)
        unresolved.append(found.in_common)
        record, common = _better_displacement(
            record, found, measured, samples, surfaces, geometry, frame_rate
        )
    if common is not None and heights is not None and frame_rate:
        z, block = record.elevation, BLOCK * geometry.pixel
        better = heights.better(heights.opened, common.of_elevation(block, np.array(z.k), frame_rate))
        z = replace(better, information=z.information, waves=z.waves)
        record = replace(record, elevation=z, temporal_truncation=truncation(z))
    record = replace(record, unresolved=stated_rise(*unresolved))
    motion = [
        (name, max(motion_variance(one.displacements[name]) for one in samples if name in one.displacements))
        for name in measured
    ]
    frames = record.temporal_truncation.best_frames(found.moved[2], found.noise_variance)
    shown = [
        (name, _shown(fields, dict(record.displacement)[name], geometry, name))
        for name, fields in measured.items()
    ]
    return replace(record, path_frames=frames, motion=tuple(motion), shown=tuple(shown))


def _truncation(
    surfaces: Sequence[tuple[Float, Float, Float] | None],
    prior: Prior,
    record: LearnedRecord,
    geometry: GridGeometry,
    frame_rate: float | None,
    z: Prior,
) -> TemporalTruncation:
    """What the frames leave out, from the surfaces that a prior and a record gave and from what z shows."""
    step = geometry.grid.step
    return temporal_truncation(
        [(first, moved) for first, _, moved in (one for one in surfaces if one is not None)],
        step,
        partial(_node_noise, prior, geometry),
        partial(_matching_gain, record, geometry),
        partial(detected_waves, z, geometry.pixel, step, frame_rate) if frame_rate else None,
    )


def _better_displacement(
    record: LearnedRecord,
    found: Differences,
    measured: Mapping[str, FieldSamples],
    samples: Sequence[_SampleStep],
    surfaces: Sequence[tuple[Float, Float, Float] | None],
    geometry: GridGeometry,
    frame_rate: float | None,
) -> tuple[LearnedRecord, CommonWaves | None]:
    """The record with spectra and noise of the displacements as the cameras' differences have them, and what
    the cameras have in common. Waves that the elevation shows by itself move the images as well.
    """
    usual = {
        name: replace(
            prior, noise=float(np.clip(prior.noise * found.noise, *_NOISE_FACTORS)), waves=found.waves
        )
        for name, prior in record.displacement
    }
    opened = {name: fields.open(usual[name]) for name, fields in measured.items()}
    moving = common = _common_waves(opened, measured, samples, surfaces, geometry)
    if common is not None and frame_rate:
        moving = common.with_elevation(record.elevation, BLOCK * geometry.pixel, frame_rate)
    priors = dict(usual)
    for name, fields in measured.items():
        k = np.array(priors[name].k)
        power = None if moving is None else moving.in_camera(geometry.sights[name], k)
        priors[name] = fields.better(opened[name], power)
    share = matching.pooled_share([prior.share for prior in priors.values()])
    priors = {name: replace(prior, share=share) for name, prior in priors.items()}
    own = {name: record.own_noise(name) * found.own.get(name, 1.0) for name in priors}
    better = replace(
        record,
        displacement=tuple(priors.items()),
        moved=found.moved,
        noise=tuple(own.items()),
        camera_jitter=found.camera_jitter,
    )
    return better, common


def _common_waves(
    opened: Mapping[str, OpenFields],
    measured: Mapping[str, FieldSamples],
    samples: Sequence[_SampleStep],
    surfaces: Sequence[tuple[Float, Float, Float] | None],
    geometry: GridGeometry,
) -> CommonWaves | None:
    """Waves that the cameras' displacements have in common; None of a light sheet."""
    if geometry.settings.sheet_thickness is not None:
        return None
    steps = []
    for step, surface in zip(samples, surfaces):
        fields: dict[str, OpenField] = {}
        for name, one in opened.items():
            for sample, found in zip(measured[name].samples, one.found):
                assert isinstance(sample, DisplacementSample)
                assert isinstance(found, FlowEstimate)
                if sample.match is step.displacements.get(name):
                    fields[name] = OpenField(one.prior, one.modes, found)
        if surface is not None:
            steps.append((fields, surface[0]))
    return common_waves(steps, geometry)


def _shown(fields: FieldSamples, prior: Prior, geometry: GridGeometry, name: str) -> tuple[float, float]:
    """`LearnedRecord.shown` of a camera, in the fields of its own prior: open ones have another noise."""
    sight, modes = geometry.sights[name], Modes(prior, fields.samples[0].field.shape[-2:])
    X, Y = sight.position(np.zeros(geometry.grid.shape, np.float32))
    visible = sight.sees(X, Y)
    if not visible.any():
        return 1.0, 1.0
    column, row = (np.rint((p[visible] - 0.5 * (BLOCK - 1)) / BLOCK).astype(np.intp) for p in (X, Y))
    row, column = (np.minimum(at, n - 1) for at, n in zip((row, column), sight.lattice.shape))

    def of(sample: FieldSample) -> Float:
        found = sample.estimate(modes)
        assert isinstance(found, FlowEstimate)
        return np.asarray(found.each[:, row, column].mean(axis=1, dtype=np.float64) / sample.bare)

    x, y = np.mean(list(fields.pool.map(of, fields.samples)), axis=0) / prior.information
    return float(x), float(y)


def _bead_widths(
    steps: Sequence[tuple[Frames, Frames]],
    masks: Sequence[tuple[Masks, Masks]],
    geometry: GridGeometry,
    pool: ThreadPoolExecutor,
) -> dict[str, float]:
    """Median width of every camera's beads, raw px."""
    out = {}
    for name in geometry.cameras:
        images = [(first.get(name), mask.get(name)) for (first, _), (mask, _) in zip(steps, masks)]
        even = [
            image if mask is None else made_even(image, mask)
            for image, mask in images
            if image is not None and usable(image, geometry.rig[name].size)
        ]
        widths = list(pool.map(bead_width, even))
        out[name] = float(np.median(widths)) if widths else 0.0
    return out


def _learn_elevation(
    steps: Sequence[_SampleStep], geometry: GridGeometry, pool: ThreadPoolExecutor
) -> FieldSamples | None:
    """The samples' elevation; None of a light sheet and where nothing shows it."""
    if geometry.settings.sheet_thickness is not None:
        return None

    def sample_of(step: _SampleStep) -> ElevationSample | None:
        if step.pairs is None:
            return None
        bare = bare_of_pairs(step.first.covered, geometry)
        return ElevationSample(*step.pairs, step.first.flat, geometry.pixel, bare)

    least = _MIN_INFORMATION / geometry.pixel**2
    samples = [one for one in pool.map(sample_of, steps) if one is not None and one.information > least]
    return FieldSamples.of(samples, geometry.settings.stereo, pool) if samples else None


def _elevation_prior(heights: FieldSamples) -> Prior:
    """The prior of the elevation with its information along the sight lines, and how much of it is waves."""
    prior = heights.prior
    modes = Modes(prior, heights.samples[0].field.shape[-2:])
    each = list(heights.pool.map(lambda sample: sample.summary(modes), heights.samples))
    information, variance, epipolar = np.mean(each, axis=0)
    prior = replace(prior, information=float(information))
    waves, noise = (float(part[0]) for part in prior.variances(modes.lattice))
    return replace(prior, waves=matching.shrinkage(variance, noise + epipolar, waves))


def _learn_displacement(
    name: str,
    steps: Sequence[_SampleStep],
    bead_width: float,
    geometry: GridGeometry,
    pool: ThreadPoolExecutor,
) -> FieldSamples | None:
    area = matching.displacement_area(bead_width / geometry.sights[name].binning)

    def sample_of(step: _SampleStep) -> DisplacementSample:
        bare = bare_of_camera([step.first.covered.get(name), step.second.covered.get(name)])
        images = step.first.raw[name], step.second.raw[name]
        return DisplacementSample(step.displacements[name], *images, bare, area)

    samples = list(pool.map(sample_of, [step for step in steps if name in step.displacements]))
    samples = [sample for sample in samples if sample.information > _MIN_INFORMATION]
    if not samples:
        return None
    return FieldSamples.of(samples, geometry.settings.piv, pool)


def _node_noise(prior: Prior, geometry: GridGeometry, k: Float) -> Float:
    """Noise in the power of every wave on the grid, by its wavenumber, rad per node."""
    blocks = BLOCK * geometry.pixel / geometry.grid.step  # from node to node of the lattice
    return np.asarray(prior.noise_power(k * blocks) * blocks**2 / np.prod(geometry.grid.shape))


def _matching_gain(record: LearnedRecord, geometry: GridGeometry, k: Float) -> Float:
    """What priors leave of waves' displacements; k in rad per node."""
    blocks = k * BLOCK * geometry.pixel / geometry.grid.step
    return np.asarray(np.mean([prior.mean_gain(blocks) for _, prior in record.displacement], axis=0))


def _elevations(
    geometry: GridGeometry, model: Model, current: bool, step: _SampleStep
) -> tuple[Float, Float, Float] | None:
    """Elevation at the nodes at two frames, and at the second where a current has taken them, metres.
    z and velocities follow the water: at nodes that stand still, waves on a current seem to turn too fast.
    """
    if step.pairs is None:
        first = elevation.surface(step.first.flat, geometry, model)
    else:
        first = elevation.surface_of(*step.pairs, step.first.flat, geometry, model)
    second = elevation.surface(step.second.flat, geometry, model)
    if first is None or second is None:
        return None
    if not current:
        return first.z, second.z, second.z
    dx, dy = _mean_flow(step, geometry)
    return first.z, second.z, second.read(geometry.x + dx, geometry.y + dy)


def _mean_flow(step: _SampleStep, geometry: GridGeometry) -> tuple[float, float]:
    """Median displacement of the water in a step, by all cameras, metres."""
    rows, moved = [], []
    for name, found in step.displacements.items():
        if found.valid.any():
            rows.append(geometry.sights[name].at_middle())
            moved += [float(np.median(part[found.valid])) for part in (found.u, found.v)]
    if len(rows) < 2:
        return 0.0, 0.0
    dx, dy, _ = np.linalg.lstsq(np.concatenate(rows), np.array(moved))[0]
    return float(dx), float(dy)


def _differences(
    geometry: GridGeometry,
    model: Model,
    step: _SampleStep,
    surfaces: tuple[Float, Float, Float] | None,
) -> Differences | None:
    """What the cameras' differences show of noise, waves and their own motion."""
    if surfaces is None:
        return None
    found = {
        name: map_displacement(
            one, step.first.raw[name], step.second.raw[name], model.displacement[name].modes
        )
        for name, one in step.displacements.items()
    }
    flows = {name: camera_flow(one, model.displacement[name]) for name, one in found.items()}
    shown = differences(flows, np.float32(0.5) * (surfaces[0] + surfaces[1]), geometry, model)
    if shown is None or geometry.settings.sheet_thickness is not None:
        return shown
    missing = {name: one.missing for name, one in flows.items()}
    curvature = {
        name: one.mean_square_curvature(model.displacement[name].modes) for name, one in found.items()
    }
    return replace(shown, in_common=in_common(found, missing, curvature, surfaces[0], geometry))
