"""Learn the beads, spectra and noise of a record from sample frames, once before its first step is measured.

The stages in order: widths of the beads; first spectra, from matched fields; noise, from differences between
the cameras, scaled so that their misfit has the median of chi^2; second spectra, with this noise; the kind of
paths; ripples. The result is a frozen `LearnedRecord`, which is stored with the cube, so that all steps are
weighted alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from wavefield import matching
from wavefield.images import fill_masked
from wavefield.matching.blocks import noise_of_scores
from wavefield.matching.kernels import BLOCK
from wavefield.matching.map_field import Modes, edge_field
from wavefield.matching.spectrum import (
    FIRST_SIGNAL_TO_NOISE,
    FOOTPRINT_VARIANCE,
    OPEN_SIGNAL_TO_NOISE,
    Prior,
    displacement_area,
    first_prior,
    refined_prior,
    shrinkage,
)
from wavefield.measurement import elevation
from wavefield.measurement.displacement import (
    FlowEstimate,
    camera_flow,
    filled,
    map_displacement,
    motion_variance,
)
from wavefield.measurement.elevation import PreparedImages, combine, first_information, map_elevation
from wavefield.measurement.error_budget import (
    RIPPLE_BLOCKS,
    best_path_frames,
    detected_waves,
    ripple_rise,
    shared_motion,
)
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.images import Masks, bead_width, images_of, usable
from wavefield.measurement.model import FieldModel, LearnedRecord, displacement_model, elevation_model
from wavefield.measurement.paths import EVEN_TIMES, displacements_at_nodes
from wavefield.measurement.velocity import image_variance, solve_motion, velocity
from wavefield.one_thread import one_thread
from wavefield.robust import robust_std
from wavefield.variables import EXACT_SIX, Quality

Frames = Mapping[str, NDArray[Any] | None]
Float = NDArray[np.floating]

SAMPLES = 4  # sample steps of a record
_ROUNDS = 2  # of noise and second spectra: the first noise is several times too small if waves are short
_MIN_INFORMATION = 1e-3  # per px^2: a block with less is uncertain by 30 px, and the sample is not used
_NOISE_FACTORS = 0.1, 10.0  # smallest and largest accepted `Prior.noise`
# The spectrum of z is learned from whole beads (`scores_at`) if their noise is below this fraction of that of
# plain blocks. The fraction is 0.9 to 1 on long waves, where plain blocks give less noise in the spectrum,
# and 0.5 to 0.7 on waves of 5 to 8 cm with slopes of 0.15.
_NOISE_WITHOUT_CUT_BEADS = 0.75
_FLAT = Prior.isotropic((0.0, np.pi), (0.0, 0.0), 1.0)  # prior for a light sheet: no waves


def sample_steps(count: int, number: int = 0) -> list[int]:
    """Return the numbers of the steps of a record from which its spectra and noise are learned.

    Parameters
    ----------
    count : int
        Number of steps of the record.
    number : int, default 0
        0, 1 or 2 select different sets; 1 and 2 are for records whose steps of set 0 cannot be measured.

    Returns
    -------
    list of int
        Numbers of at most four steps, counted from 0, evenly spaced over the record.

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
        First and second frame of every sample step (`sample_steps`), per camera; None for a missing frame.
    geometry : GridGeometry
        Rig, grid and settings.
    masks : sequence of (mapping, mapping), optional
        True on pixels to ignore, per step, frame and camera; None for no mask.
    threads : int, default 1
        Number of steps that are computed in parallel; the result does not depend on it.
    frame_rate : float, optional
        Frames per second, Hz. Without it, paths are the exact ones through six frames.

    Returns
    -------
    LearnedRecord or None
        The argument of `Model`; None if z or the displacement of two cameras cannot be measured in any step.
    """
    with ThreadPoolExecutor(threads) as pool:
        return _learned(steps, geometry, masks or [({}, {})] * len(steps), pool, frame_rate)


def _learned(
    steps: Sequence[tuple[Frames, Frames]],
    geometry: GridGeometry,
    masks: Sequence[tuple[Masks, Masks]],
    pool: ThreadPoolExecutor,
    frame_rate: float | None,
) -> LearnedRecord | None:
    """Run all stages of `learn` in order, with a pool of threads; other arguments are as in `learn`."""
    # widths of the beads, which the preparation of the images needs
    beads = _bead_widths(steps, masks, geometry, pool)
    samples = list(pool.map(partial(_SampleStep.match, geometry, beads), steps, masks))
    # first spectra
    heights = [] if geometry.z_is_known else _elevation_samples(samples, geometry, pool)
    moved = {name: _displacement_samples(name, samples, beads, geometry, pool) for name in geometry.sights}
    moved = {name: fields for name, fields in moved.items() if fields and name in geometry.velocity_cameras}
    if len(moved) < 2 or not (heights or geometry.z_is_known):
        return None
    z_prior, noise = _elevation_prior(heights, pool) if heights else (_FLAT, 0.0)
    if heights and all(beads.values()):
        heights = _elevation_samples(samples, geometry, pool, True)
        if _summary(heights, z_prior, pool)[3] < _NOISE_WITHOUT_CUT_BEADS * noise:
            z_prior, _ = _elevation_prior(heights, pool)
    priors = {name: _first_spectrum(fields, pool) for name, fields in moved.items()}
    some = next(iter(priors.values()))
    priors = {name: priors.get(name, some) for name in geometry.velocity_cameras}
    # noise, from differences between the cameras, and second spectra with it
    z_model = elevation_model(geometry, z_prior, beads)
    surfaces = list(pool.map(lambda one: _mean_elevation(one, geometry, z_model), samples))
    for _ in range(_ROUNDS):
        models = {name: displacement_model(geometry, name, prior) for name, prior in priors.items()}
        each = pool.map(partial(_differences, geometry, models), samples, surfaces)
        found = _Differences.typical([one for one in each if one is not None])
        for name, prior in priors.items():
            noise = float(np.clip(prior.noise * found.noise, *_NOISE_FACTORS))
            prior = replace(prior, noise=noise, wave_fraction=found.waves)
            priors[name] = (
                _refined(moved[name], prior, OPEN_SIGNAL_TO_NOISE, pool) if name in moved else prior
            )
    # all cameras see the same waves
    fraction = float(np.mean([prior.undetected_fraction for prior in priors.values()]))
    priors = {name: replace(prior, undetected_fraction=fraction) for name, prior in priors.items()}
    # the kind of paths with the smallest error, and ripples
    path_frames = EXACT_SIX
    if frame_rate is not None:
        waves = detected_waves(z_prior, geometry.pixel, frame_rate)
        path_frames = best_path_frames(waves, found.noise_variance)
    rise = 0.0 if geometry.z_is_known else ripple_rise(found.shared, found.total)
    motion = {
        name: max(motion_variance(one.displacements[name]) for one in samples if name in one.displacements)
        for name in moved
    }
    return LearnedRecord(
        tuple(beads.items()),
        z_prior,
        tuple(priors.items()),
        tuple(motion.items()),
        path_frames,
        (rise, RIPPLE_BLOCKS * BLOCK * geometry.pixel),
    )


@dataclass(frozen=True)
class _SampleStep:
    """Prepared images of one sample step, with matches between cameras and in time, made without a prior."""

    flat: tuple[PreparedImages, PreparedImages]  # rectified, of both frames
    in_time: tuple[PreparedImages, PreparedImages]  # not rectified
    pairs: elevation.MatchedPairs | None  # of the first frame; None if it shows no surface
    displacements: Mapping[str, matching.Displacement]  # from the first frame to the second, per camera

    @classmethod
    def match(
        cls,
        geometry: GridGeometry,
        beads: Mapping[str, float],
        frames: tuple[Frames, Frames],
        masks: tuple[Masks, Masks],
    ) -> _SampleStep:
        """Prepare the images of both frames of a step, and match them between cameras and in time.
        `frames`, `masks` (True on pixels to ignore) and `beads` (bead widths, raw px) are by camera."""
        one, two = (images_of(part, geometry, beads, mask) for part, mask in zip(frames, masks))
        flat, (first, second) = (one.rectified(), two.rectified()), (one.in_time(), two.in_time())
        found = {
            name: matching.match(first[name], second[name], geometry.settings.piv)
            for name in first
            if name in second
        }
        return cls(flat, (first, second), elevation.match_pairs(flat[0], geometry), found)


def _bead_widths(
    steps: Sequence[tuple[Frames, Frames]],
    masks: Sequence[tuple[Masks, Masks]],
    geometry: GridGeometry,
    pool: ThreadPoolExecutor,
) -> dict[str, float]:
    """Return, by camera, the median width of the beads in first frames of steps, raw px; 0 for a texture."""
    out = {}
    for name in geometry.cameras:
        images = [(first.get(name), mask.get(name)) for (first, _), (mask, _) in zip(steps, masks)]
        even = [
            image if mask is None else fill_masked(image, mask)
            for image, mask in images
            if image is not None and usable(image, geometry.rig[name].size)
        ]
        widths = list(pool.map(bead_width, even))
        out[name] = float(np.median(widths)) if widths else 0.0
    return out


@dataclass(frozen=True)
class _FieldSample:
    """One field (elevation or displacement) of a sample step; its functions estimate it with a prior."""

    field: Float  # (c, ny, nx): the matched field, holes filled
    information: float  # mean over the blocks that have any
    area: float  # variance of the area that a block's value averages over, px^2 (`Prior`)
    estimate: Callable[[Modes], tuple[Float, float]]  # coefficients of the MAP field, mean information
    # the same for the component across the sight lines, which contains only noise; for elevations
    noise: Callable[[Modes], tuple[Float, float]] | None = None
    # mean information, variance of z and of the smooth epipolar error, m^2, noise of the scores; for
    # elevations
    summary: Callable[[Modes], tuple[float, float, float, float]] | None = None


def _without_holes(found: elevation.ElevationEstimate | FlowEstimate) -> tuple[Float, float]:
    """Return a tuple: coefficients of a MAP field, scaled up for holes; mean inverse variance of its blocks.
    Holes are blocks without information; the mean is over the others."""
    known = float(np.mean(found.information > 0))
    if not known:
        return found.waves, 0.0
    return found.waves / np.sqrt(known), float(found.information.mean()) / known


def _elevation_samples(
    steps: Sequence[_SampleStep], geometry: GridGeometry, pool: ThreadPoolExecutor, whole_beads: bool = False
) -> list[_FieldSample]:
    """Return the elevation in the first frame of each sample step; steps without elevation are left out."""

    def sample_of(step: _SampleStep) -> _FieldSample | None:
        if step.pairs is None:
            return None
        blocks, matches = step.pairs
        flat, pixel = step.flat[0], geometry.pixel
        turned = [one.turned for one in matches]  # across the sight lines, where waves displace nothing

        def estimate(modes: Modes) -> tuple[Float, float]:
            # noise from the scores along the sight lines: if it were larger there than across, the excess
            # would count as waves
            return _without_holes(map_elevation(blocks, matches, flat, modes, pixel, whole_beads, False))

        def noise(modes: Modes) -> tuple[Float, float]:
            found = map_elevation(combine(turned), turned, flat, modes, pixel, whole_beads, False)
            return _without_holes(found)

        def summary(modes: Modes) -> tuple[float, float, float, float]:
            found = map_elevation(blocks, matches, flat, modes, pixel, whole_beads)
            z = modes.field(found.waves)[0][found.information > 0]
            variance = robust_std(z - np.median(z)) ** 2 if z.size else 0.0
            return _without_holes(found)[1], variance, found.epipolar**2, found.noise

        information = first_information(blocks, matches, pixel)
        return _FieldSample(blocks.filled, information, FOOTPRINT_VARIANCE, estimate, noise, summary)

    least = _MIN_INFORMATION / geometry.pixel**2
    return [one for one in pool.map(sample_of, steps) if one is not None and one.information > least]


def _displacement_samples(
    name: str,
    steps: Sequence[_SampleStep],
    beads: Mapping[str, float],
    geometry: GridGeometry,
    pool: ThreadPoolExecutor,
) -> list[_FieldSample]:
    """Return the displacement of camera `name` in each sample step; steps without displacement are left out.
    `beads` are bead widths by camera, raw px."""
    area = displacement_area(beads.get(name, 0.0) / geometry.sights[name].binning)

    def sample_of(step: _SampleStep) -> _FieldSample:
        match = step.displacements[name]
        first, second = (images[name] for images in step.in_time)

        def estimate(modes: Modes) -> tuple[Float, float]:
            return _without_holes(map_displacement(match, first, second, modes))

        counts = match.valid.astype(np.float32)
        trace = match.hessian[0] + match.hessian[2]
        nu = noise_of_scores(match.score, trace, counts, 1.0, with_mismatches=True)
        information = 0.5 * float((trace / nu)[match.valid].mean()) if match.valid.any() else 0.0
        return _FieldSample(filled(match), information, area, estimate)

    with_displacement = [step for step in steps if name in step.displacements]
    return [one for one in pool.map(sample_of, with_displacement) if one.information > _MIN_INFORMATION]


def _first_spectrum(samples: Sequence[_FieldSample], pool: ThreadPoolExecutor) -> Prior:
    """Learn a prior from the spectrum of the samples' matched fields; refine it twice by MAP estimates."""
    fields = [one.field - edge_field(one.field) for one in samples]
    typical = float(np.mean([one.information for one in samples]))
    prior = first_prior(fields, typical, samples[0].area)
    for ratio in (FIRST_SIGNAL_TO_NOISE, OPEN_SIGNAL_TO_NOISE):
        prior = _refined(samples, prior, ratio, pool)
    return prior


def _refined(samples: Sequence[_FieldSample], prior: Prior, ratio: float, pool: ThreadPoolExecutor) -> Prior:
    """Return a prior with the spectrum, without noise, of the MAP fields that are estimated with `prior`.
    For this estimate, the signal-to-noise ratio of `prior` is raised to at least `ratio`."""
    prior = prior.with_min_signal_to_noise(ratio)
    modes = Modes(prior, samples[0].field.shape[-2:])
    waves, information = zip(*pool.map(lambda one: one.estimate(modes), samples))
    noise = pool.map(lambda one: one.noise(modes), [one for one in samples if one.noise])
    alone = [(field, own) for field, own in noise if own > 0]
    return refined_prior(prior, modes.lattice, waves, float(np.mean(information)), alone)


def _elevation_prior(samples: Sequence[_FieldSample], pool: ThreadPoolExecutor) -> tuple[Prior, float]:
    """Return a tuple: prior of z with its wave fraction; variance of scores divided by their Hessian."""
    prior = _first_spectrum(samples, pool)
    information, variance, epipolar, of_scores = _summary(samples, prior, pool)
    prior = replace(prior, information=information)
    waves, noise = (float(part[0]) for part in prior.variances(samples[0].field.shape[-2:]))
    return replace(prior, wave_fraction=shrinkage(variance, noise + epipolar, waves)), of_scores


def _summary(samples: Sequence[_FieldSample], prior: Prior, pool: ThreadPoolExecutor) -> list[float]:
    """Return the four numbers of `_FieldSample.summary` for this prior, each averaged over the samples."""
    modes = Modes(prior, samples[0].field.shape[-2:])
    each = [one.summary for one in samples if one.summary]
    return [float(mean) for mean in np.mean(list(pool.map(lambda summary: summary(modes), each)), axis=0)]


def _mean_elevation(step: _SampleStep, geometry: GridGeometry, model: FieldModel) -> Float | None:
    """Return z (ny, nx), metres, averaged over both frames of a step; None if one cannot be measured."""
    if step.pairs is None:
        first = elevation.surface(step.flat[0], geometry, model)
    else:
        first = elevation.surface_of(*step.pairs, step.flat[0], geometry, model)
    second = elevation.surface(step.flat[1], geometry, model)
    if first is None or second is None:
        return None
    return np.asarray(np.float32(0.5) * (first.z + second.z))


@dataclass(frozen=True)
class _Differences:
    """Noise and wave parameters, found from differences between the displacements of the cameras."""

    noise: float = 1.0  # noise of the displacements over that which the priors predict
    waves: float = 1.0  # fraction of the displacements' spectra that is waves
    noise_variance: float = 0.0  # of dx, dy and dz of the water together, m^2
    shared: float = 0.0  # both results of `shared_motion`, m^2
    total: float = 0.0

    @classmethod
    def typical(cls, steps: Sequence[_Differences]) -> _Differences:
        """Return the median of each number over several steps; the defaults if there are no steps."""
        if not steps:
            return cls()
        return cls(*map(float, np.median([astuple(one) for one in steps], axis=0)))


def _differences(
    geometry: GridGeometry, models: Mapping[str, FieldModel], step: _SampleStep, z: Float | None
) -> _Differences | None:
    """Compare the displacements of the cameras in a step, on the surface z (ny, nx), metres.
    Returns None if z is None or if nothing can be compared. `models` are the estimators by camera."""
    if z is None:
        return None
    first, second = step.in_time
    found = {
        name: map_displacement(one, first[name], second[name], models[name].modes)
        for name, one in step.displacements.items()
    }
    flows = {name: camera_flow(one, models[name]) for name, one in found.items()}
    path = (None, flows, None)
    motion = velocity(path, z, geometry, EXACT_SIX, EVEN_TIMES)
    if motion is None:
        return None
    names = [name for name in flows if name != motion.left_out]
    displacements = displacements_at_nodes(names, path, z, geometry, EXACT_SIX, EVEN_TIMES)
    good = np.isfinite(motion.misfit) & ((motion.quality & Quality.FILLED) == 0)
    good &= np.isfinite(displacements.moved).all(axis=0)
    if not good.any():
        return None
    # subtract the median misfit: a camera that shakes moves its whole image, which is not noise of blocks
    fitted = np.einsum("riyx,iyx->ryx", displacements.jacobian, motion.d)
    rest = np.median((displacements.moved - fitted)[:, good], axis=1)
    steady = replace(displacements, moved=displacements.moved - rest[:, None, None].astype(np.float32))
    parts = geometry.wave_variances
    solved = solve_motion(steady, parts)
    freedom = 2 * len(names) - 3
    noise = float(np.median(solved.misfit[good])) / (2 * gammaincinv(freedom / 2, 0.5) / freedom)
    # waves are what the cameras share: averaging over cameras reduces the noise, but not the waves
    noise_variance = noise * float(solved.noise[:, good].mean(axis=1, dtype=np.float64).sum())
    each = image_variance(displacements, parts)[:, good].mean(axis=1)
    waves = [
        models[name].prior.variances(models[name].modes.lattice)[0].mean() / one
        for name, one in zip(names, each, strict=True)
    ]
    variance = float(np.var(solved.d[:, good], axis=1, dtype=np.float64).sum())
    fraction = shrinkage(variance, noise_variance, float(np.mean(waves) * parts.sum()))
    return _Differences(noise, fraction, noise_variance, *shared_motion(found, z, geometry))
