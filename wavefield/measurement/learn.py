"""What sample frames of a whole record say: beads, spectra, noise. Once per run, before its first step."""

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
from wavefield.matching.prior import FIRST_SIGNAL_TO_NOISE, OPEN_SIGNAL_TO_NOISE
from wavefield.measurement import elevation, flow
from wavefield.measurement.background import bead_width
from wavefield.measurement.differences import Differences, differences, typical
from wavefield.measurement.frame import usable
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.instant import Images, images_of
from wavefield.measurement.learned_record import LearnedRecord
from wavefield.measurement.masked import Masks, bare_of_camera, bare_of_pairs
from wavefield.measurement.model import Model
from wavefield.measurement.pair_surface import PairMatch
from wavefield.measurement.paths import noise_weights
from wavefield.measurement.temporal_truncation import TemporalTruncation, temporal_truncation

Frames = Mapping[str, NDArray[Any] | None]
Float = NDArray[Any]

SAMPLES = 4  # steps of a record that are looked at
_DOUBT = 1.5  # times what waves are thought to lose along a path
_ROUNDS = 2  # of spectrum and field in turn
_FREEDOM = 0.6  # fraction of the scores' noise that windows leave in them, about
_NOISE = 0.1, 10.0  # factors on the noise that are believed
_HALF = 0.6745  # standard deviations of a Gaussian within which half of it lies: edges do not count so
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
) -> LearnedRecord | None:
    """Learn a record's beads, spectra and noise from sample frames.

    Parameters
    ----------
    steps : sequence of (mapping, mapping)
        First and second frame of some steps, per camera; None where absent. `sample_steps` says which.
    geometry : GridGeometry
        Rig, grid and settings.
    masks : sequence of (mapping, mapping), optional
        True where pixels of these frames do not count, per camera; None where all do.
    threads : int, default 1
        Steps that are worked on side by side; the result does not depend on it.

    Returns
    -------
    LearnedRecord or None
        For a `Model`; None if none of the frames can be measured.

    Notes
    -----
    The first spectrum is that of windowed fields over the windows' gain; then fields and spectra follow from
    each other (`better_prior`). The noise of the displacements is what makes the cameras' misfit what it
    should be: the median of chi^2.
    """
    with ThreadPoolExecutor(threads) as pool:
        return _learned(steps, geometry, masks or [({}, {})] * len(steps), pool)


def _learned(
    steps: Sequence[tuple[Frames, Frames]],
    geometry: GridGeometry,
    covered: Sequence[tuple[Masks, Masks]],
    pool: ThreadPoolExecutor,
) -> LearnedRecord | None:
    beads = _beads(steps, covered, geometry, pool)

    def view(step: tuple[Frames, Frames], masked: tuple[Masks, Masks]) -> tuple[Images, Images]:
        (one, other), (m, n) = step, masked
        return images_of(one, geometry, beads, m), images_of(other, geometry, beads, n)

    def match(view: tuple[Images, Images]) -> _Near:
        one, other = (images.raw for images in view)
        found = {n: matching.match(one[n], other[n], geometry.settings.piv) for n in one if n in other}
        return _Near(elevation.match_pairs(view[0].flat, geometry), found)

    views = list(pool.map(view, steps, covered))
    near = list(pool.map(match, views))
    height = _learn_elevation(views, near, geometry, pool)
    moves = {
        name: _learn_displacement(name, views, near, geometry, pool) for name in geometry.velocity_cameras
    }
    known = {name: samples for name, samples in moves.items() if samples is not None}
    if height is None or len(known) < 2:
        return None
    some = next(iter(known.values()))
    priors = {name: known.get(name, some).prior for name in geometry.velocity_cameras}
    record = LearnedRecord(tuple(beads.items()), height, tuple(priors.items()), (1.0, 1.0, 1.0))
    model = Model(geometry, record)
    pairs = list(pool.map(partial(_elevations, geometry, model), views, near))
    heights = [None if pair is None else np.float32(0.5) * (pair[0] + pair[1]) for pair in pairs]
    known_pairs = [pair for pair in pairs if pair is not None]
    record = replace(
        record,
        temporal_truncation=temporal_truncation(
            known_pairs,
            geometry.grid.step,
            partial(_noise_of_waves, height, geometry),
            partial(_matched, record, geometry),
        ),
    )
    for number in range(2):
        if number:
            model = Model(geometry, record, model)
        found = _differences(views, near, heights, geometry, model, pool)
        priors = {}
        for name, prior in record.displacement:
            factor = float(np.clip(prior.noise * found.noise, *_NOISE))
            prior = replace(prior, noise=factor, waves=found.waves)
            priors[name] = known[name].better(prior) if name in known else prior
        own = {name: record.own_noise(name) * found.own.get(name, 1.0) for name in priors}
        record = replace(
            record,
            displacement=tuple(priors.items()),
            moved=found.moved,
            noise=tuple(own.items()),
            camera_jitter=found.camera_jitter,
        )
    return replace(record, path_frames=_path_frames(found, record.temporal_truncation))


def _path_frames(found: Differences, temporal_truncation: TemporalTruncation) -> int:
    """Frames that leave least of the water's displacement wrong: by noise, and of waves that turn fast.

    Four where few waves tell how fast; six have to be better by more than what that is uncertain by.
    """

    def wrong(frames: int) -> float:
        here, *beside = noise_weights(frames)
        lost = found.moved[2] ** 2 * temporal_truncation.total(frames)
        return found.scatter * (here + 2.0 * sum(beside)) + _DOUBT**2 * lost

    return 6 if 6 in dict(temporal_truncation.d) and wrong(6) < wrong(4) else 4


@dataclass(frozen=True)
class _Near:
    """What matching finds of a step, whatever the prior: pairs at its first frame, displacements."""

    pairs: tuple[elevation.Blocks, list[PairMatch]] | None
    displacements: Mapping[str, matching.Displacement]


def _beads(
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
    views: Sequence[tuple[Images, Images]],
    near: Sequence[_Near],
    geometry: GridGeometry,
    pool: ThreadPoolExecutor,
) -> Prior | None:
    if geometry.settings.sheet_thickness is not None:
        return _FLAT

    def sample_of(view: tuple[Images, Images], found: _Near) -> _Height | None:
        if found.pairs is None:
            return None
        return _Height(*found.pairs, view[0].flat, geometry.pixel, bare_of_pairs(view[0].covered, geometry))

    samples = [sample for sample in pool.map(sample_of, views, near) if sample is not None]
    if not samples:
        return None
    prior = _Samples.of(samples, geometry.settings.stereo, pool).prior
    modes = Modes(prior, geometry.lattice.shape)

    def summarize(sample: _Height) -> tuple[float, float, float]:
        """Information of a block, variance of z, and of what is smooth across sight lines."""
        estimate = elevation.most_probable(*sample.parts, modes, geometry.pixel)
        z = modes.field(estimate.waves - estimate.mean)[0][estimate.information > 0]
        apart = float(np.median(np.abs(z - np.median(z)))) / _HALF if z.size else 0.0
        return float(estimate.information.mean()) / sample.bare, apart**2, estimate.miss**2

    information, variance, miss = np.mean(list(pool.map(summarize, samples)), axis=0)
    prior = replace(prior, information=float(information))
    waves, noise = (float(part[0]) for part in prior.variances(modes.lattice))
    return replace(prior, waves=matching.shrinkage(variance, noise + miss, waves))


def _learn_displacement(
    name: str,
    views: Sequence[tuple[Images, Images]],
    near: Sequence[_Near],
    geometry: GridGeometry,
    pool: ThreadPoolExecutor,
) -> _Samples | None:
    def sample_of(step: tuple[tuple[Images, Images], _Near]) -> _Shift:
        (one, other), found = step
        bare = bare_of_camera([one.covered.get(name), other.covered.get(name)])
        return _Shift(found.displacements[name], one.raw[name], other.raw[name], bare)

    there = [step for step in zip(views, near) if name in step[1].displacements]
    samples = list(pool.map(sample_of, there))
    if not any(sample.information > 0 for sample in samples):
        return None
    return _Samples.of(samples, geometry.settings.piv, pool)


class _Sample:
    """One field: as windows have it, and as a prior makes it.

    `information` is the mean of the blocks that are not masked, `bare` their fraction: a mask says nothing of
    the water, which is as rough and as well seen beneath it as beside it.
    """

    field: Float
    information: float
    bare: float

    def estimate(self, modes: Modes) -> elevation.ElevationEstimate | flow.FlowEstimate:
        """The most probable field."""
        raise NotImplementedError

    def noise(self, modes: Modes) -> tuple[Float, float] | None:
        """Coefficients of a field of noise alone and its information, where the cameras show one."""
        return None


class _Height(_Sample):
    def __init__(
        self,
        blocks: elevation.Blocks,
        matches: Sequence[PairMatch],
        prepared: Mapping[str, matching.PreparedImage],
        pixel: float,
        bare: float,
    ) -> None:
        self.parts, self._pixel, self.bare = (blocks, matches, prepared), pixel, bare
        self.field = blocks.whole
        self.information = elevation.first_information(blocks, matches, pixel, _FREEDOM) / bare

    def estimate(self, modes: Modes) -> elevation.ElevationEstimate:
        # noise from the same scores as the field: taken across, what is more along would pass for waves
        return elevation.most_probable(*self.parts, modes, self._pixel, across=False)

    def noise(self, modes: Modes) -> tuple[Float, float] | None:
        """As if the sight lines were turned by a quarter: no wave moves anything across them."""
        _, matches, prepared = self.parts
        turned = elevation.turned(matches)
        blocks = elevation.combine(turned)
        found = elevation.most_probable(blocks, turned, prepared, modes, self._pixel, across=False)
        information = float(found.information.mean()) / self.bare
        return ((found.waves - found.mean) / np.sqrt(self.bare), information) if information > 0 else None


class _Shift(_Sample):
    def __init__(
        self,
        found: matching.Displacement,
        one: matching.PreparedImage,
        other: matching.PreparedImage,
        bare: float,
    ) -> None:
        self._parts, self.bare = (found, one, other), bare
        self.field = flow.whole(found)
        counts = found.valid.astype(np.float32)
        trace = found.hessian[0] + found.hessian[2]
        nu = matching.noise_of_scores(found.score, trace, counts, _FREEDOM, with_mismatches=True)
        self.information = 0.5 * float((trace * counts / nu).mean()) / bare

    def estimate(self, modes: Modes) -> flow.FlowEstimate:
        return flow.most_probable(*self._parts, modes)


@dataclass
class _Samples:
    """Fields of one kind, and the prior that they share."""

    samples: Sequence[_Sample]
    prior: Prior
    pool: ThreadPoolExecutor

    @classmethod
    def of(
        cls, samples: Sequence[_Sample], settings: matching.MatchSettings, pool: ThreadPoolExecutor
    ) -> _Samples:
        shape = samples[0].field.shape[-2:]
        kx, ky = (np.pi * np.arange(n) / n for n in shape[::-1])
        window = matching.transfer_function(settings, kx, ky[:, None]).clip(0, 1)
        fields = [s.field - matching.edge_slopes(s.field) for s in samples]
        typical = float(np.mean([s.information for s in samples]))
        out = cls(samples, matching.first_prior(fields, window, typical), pool)
        for number in range(_ROUNDS):
            out.prior = out.better(out.prior, OPEN_SIGNAL_TO_NOISE if number else FIRST_SIGNAL_TO_NOISE)
        return out

    def better(self, prior: Prior, open_ratio: float = OPEN_SIGNAL_TO_NOISE) -> Prior:
        """The prior that follows from the fields that this one gives where it suppresses no wave."""
        prior = prior.with_min_signal_to_noise(open_ratio)
        modes = Modes(prior, self.samples[0].field.shape[-2:])
        found = list(self.pool.map(lambda sample: sample.estimate(modes), self.samples))
        information = float(np.mean([f.information.mean() / s.bare for f, s in zip(found, self.samples)]))
        waves = [(f.waves - f.mean) / np.sqrt(s.bare) for f, s in zip(found, self.samples)]
        alone = [noise for noise in self.pool.map(lambda sample: sample.noise(modes), self.samples) if noise]
        return matching.better_prior(prior, modes.kx, modes.ky, modes.foot, waves, information, alone)


def _noise_of_waves(prior: Prior, geometry: GridGeometry, k: Float) -> Float:
    """Noise in the power of every wave on the grid, by its wavenumber, rad per node."""
    blocks = BLOCK * geometry.pixel / geometry.grid.step  # from node to node of the lattice
    out: Float = prior.noise_power(k * blocks) * blocks**2 / np.prod(geometry.grid.shape)
    return out


def _matched(record: LearnedRecord, geometry: GridGeometry, k: Float) -> tuple[Float, Float]:
    """What priors leave of waves' displacements, and by how much these are raised; k in rad per node."""
    blocks = k * BLOCK * geometry.pixel / geometry.grid.step
    gain = np.mean([prior.mean_gain(blocks) for _, prior in record.displacement], axis=0)
    return gain, matching.footprint_excess(blocks)


def _elevations(
    geometry: GridGeometry, model: Model, step: tuple[Images, Images], near: _Near
) -> tuple[Float, Float] | None:
    """Elevation at the nodes at two frames, metres."""
    flat, later = (view.flat for view in step)
    if near.pairs is None:
        one = elevation.surface(flat, geometry, model)
    else:
        one = elevation.surface_of(*near.pairs, flat, geometry, model)
    other = elevation.surface(later, geometry, model)
    return None if one is None or other is None else (one.z, other.z)


def _differences(
    views: Sequence[tuple[Images, Images]],
    near: Sequence[_Near],
    heights: Sequence[Float | None],
    geometry: GridGeometry,
    model: Model,
    pool: ThreadPoolExecutor,
) -> Differences:
    """What the cameras' differences say, of all samples."""

    def move(view: tuple[Images, Images], found: _Near, z: Float | None) -> Differences | None:
        if z is None:
            return None
        one, other = (images.raw for images in view)
        flows = {
            n: flow.flow_near(d, one[n], other[n], model.displacement[n])
            for n, d in found.displacements.items()
        }
        return differences(flows, z, geometry, model)

    return typical([one for one in pool.map(move, views, near, heights) if one is not None], geometry.pixel)
