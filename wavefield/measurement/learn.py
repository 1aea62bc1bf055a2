"""What sample frames of a whole record say: beads, spectra, noise. Once per run, before its first step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from wavefield import matching
from wavefield.images import made_even
from wavefield.matching import Modes, Prior
from wavefield.matching.kernels import BLOCK
from wavefield.matching.one_thread import one_thread
from wavefield.measurement import elevation, flow
from wavefield.measurement.covered import Masks, bare_of_camera, bare_of_pairs
from wavefield.measurement.each_camera import noise_of_each, own_noise
from wavefield.measurement.floor import bead_width
from wavefield.measurement.frame import usable
from wavefield.measurement.instant import Images, images_of
from wavefield.measurement.plan import Plan
from wavefield.measurement.record import Record
from wavefield.measurement.surface import PairMatch
from wavefield.measurement.unresolved import unresolved
from wavefield.measurement.velocity import look_at_nodes, misfit, velocity
from wavefield.variables import Quality

Frames = Mapping[str, NDArray[Any] | None]
Float = NDArray[Any]

SAMPLES = 4  # steps of a record that are looked at
_ROUNDS = 2  # of spectrum and field in turn
_FREEDOM = 0.6  # fraction of the scores' noise that windows leave in them, about
_NOISE = 0.1, 10.0  # factors on the noise that are believed
_FLAT = Prior.isotropic((0.0, np.pi), (1e-12, 1e-12), 1.0)  # of a light sheet: no waves
_STILL = 1e-3  # of the pixel: the least motion from frame to frame that water is thought to have


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
    wanted = min(count, SAMPLES)
    return [int((i + 0.5 + number / 3) * count / wanted) % count for i in range(wanted)]


@one_thread()
def learn(
    steps: Sequence[tuple[Frames, Frames]],
    plan: Plan,
    masks: Sequence[tuple[Masks, Masks]] | None = None,
    threads: int = 1,
) -> Record | None:
    """Learn a record's beads, spectra and noise from sample frames.

    Parameters
    ----------
    steps : sequence of (mapping, mapping)
        First and second frame of some steps, per camera; None where absent. `sample_steps` says which.
    plan : Plan
        Rig, grid and settings.
    masks : sequence of (mapping, mapping), optional
        True where pixels of these frames do not count, per camera; None where all do.
    threads : int, default 1
        Steps that are worked on side by side; the result does not depend on it.

    Returns
    -------
    Record or None
        For `Plan.knowing`; None if none of the frames can be measured.

    Notes
    -----
    The first spectrum is that of windowed fields over the windows' gain; then fields and spectra follow from
    each other (`better_prior`). The noise of the displacements is what makes the cameras' misfit what it
    should be: the median of chi^2.
    """
    with ThreadPoolExecutor(threads) as pool:
        return _learned(steps, plan, masks or [({}, {})] * len(steps), pool)


def _learned(
    steps: Sequence[tuple[Frames, Frames]],
    plan: Plan,
    covered: Sequence[tuple[Masks, Masks]],
    pool: ThreadPoolExecutor,
) -> Record | None:
    beads = _beads(steps, covered, plan, pool)

    def view(step: tuple[Frames, Frames], masked: tuple[Masks, Masks]) -> tuple[Images, Images]:
        (one, other), (m, n) = step, masked
        return images_of(one, plan, beads, m), images_of(other, plan, beads, n)

    def match(view: tuple[Images, Images]) -> _Near:
        one, other = (images.raw for images in view)
        found = {n: matching.match(one[n], other[n], plan.settings.piv) for n in one if n in other}
        return _Near(elevation.look_at_pairs(view[0].flat, plan), found)

    views = list(pool.map(view, steps, covered))
    near = list(pool.map(match, views))
    height = _learn_elevation(views, near, plan, pool)
    moves = {name: _learn_displacement(name, views, near, plan, pool) for name in plan.velocity_cameras}
    known = {name: samples for name, samples in moves.items() if samples is not None}
    if height is None or len(known) < 2:
        return None
    some = next(iter(known.values()))
    priors = {name: known.get(name, some).prior for name in plan.velocity_cameras}
    record = Record(tuple(beads.items()), height, tuple(priors.items()), (1.0, 1.0, 1.0))
    known_plan = plan = plan.knowing(record)
    pairs = list(pool.map(lambda step, found: _elevations(step, found, known_plan), views, near))
    heights = [None if pair is None else np.float32(0.5) * (pair[0] + pair[1]) for pair in pairs]
    known_pairs = [pair for pair in pairs if pair is not None]
    record = replace(
        record,
        unresolved=unresolved(
            known_pairs,
            plan.grid.step,
            partial(_noise_of_waves, height, plan),
            partial(_matched, record, plan),
        ),
    )
    for number in range(2):
        if number:
            plan = plan.knowing(record)
        noise, own, moved, trembling = _misfit(views, near, heights, plan, pool)
        priors = {}
        for name, prior in record.displacement:
            prior = replace(prior, noise=float(np.clip(prior.noise * noise, *_NOISE)))
            priors[name] = known[name].better(prior) if name in known else prior
        own = {name: record.own_noise(name) * own.get(name, 1.0) for name in priors}
        record = replace(
            record,
            displacement=tuple(priors.items()),
            moved=moved,
            noise=tuple(own.items()),
            trembling=trembling,
        )
    return record


@dataclass(frozen=True)
class _Near:
    """What matching finds of a step, whatever the prior: pairs at its first frame, displacements."""

    pairs: tuple[elevation.Blocks, list[PairMatch]] | None
    displacements: Mapping[str, matching.Displacement]


def _beads(
    steps: Sequence[tuple[Frames, Frames]],
    masks: Sequence[tuple[Masks, Masks]],
    plan: Plan,
    pool: ThreadPoolExecutor,
) -> dict[str, float]:
    """Median width of every camera's beads, raw px."""
    out = {}
    for name in plan.cameras:
        images = [(first.get(name), mask.get(name)) for (first, _), (mask, _) in zip(steps, masks)]
        even = [
            image if mask is None else made_even(image, mask)
            for image, mask in images
            if image is not None and usable(image, plan.rig[name].size)
        ]
        widths = list(pool.map(bead_width, even))
        out[name] = float(np.median(widths)) if widths else 0.0
    return out


def _learn_elevation(
    views: Sequence[tuple[Images, Images]], near: Sequence[_Near], plan: Plan, pool: ThreadPoolExecutor
) -> Prior | None:
    if plan.settings.sheet_thickness is not None:
        return _FLAT

    def look(view: tuple[Images, Images], found: _Near) -> _Height | None:
        if found.pairs is None:
            return None
        return _Height(*found.pairs, view[0].flat, plan.pixel, bare_of_pairs(view[0].covered, plan))

    samples = [sample for sample in pool.map(look, views, near) if sample is not None]
    if not samples:
        return None
    prior = _Samples.of(samples, plan.settings.stereo, pool).prior
    modes = Modes(prior, plan.lattice.shape)

    def told(sample: _Height) -> float:
        estimate = elevation.most_probable(*sample.parts, modes, plan.pixel)
        return float(estimate.information.mean()) / sample.bare

    return replace(prior, information=float(np.mean(list(pool.map(told, samples)))))


def _learn_displacement(
    name: str,
    views: Sequence[tuple[Images, Images]],
    near: Sequence[_Near],
    plan: Plan,
    pool: ThreadPoolExecutor,
) -> _Samples | None:
    def look(step: tuple[tuple[Images, Images], _Near]) -> _Shift:
        (one, other), found = step
        bare = bare_of_camera([one.covered.get(name), other.covered.get(name)])
        return _Shift(found.displacements[name], one.raw[name], other.raw[name], bare)

    there = [step for step in zip(views, near) if name in step[1].displacements]
    samples = list(pool.map(look, there))
    if not any(sample.information > 0 for sample in samples):
        return None
    return _Samples.of(samples, plan.settings.piv, pool)


class _Sample:
    """One field: as windows have it, and as a prior makes it.

    `information` is the mean of the blocks that are not masked, `bare` their fraction: a mask says nothing of
    the water, which is as rough and as well seen beneath it as beside it.
    """

    field: Float
    information: float
    bare: float

    def estimate(self, modes: Modes) -> elevation.Estimate | flow.Estimate:
        """The most probable field."""
        raise NotImplementedError


class _Height(_Sample):
    def __init__(
        self,
        blocks: elevation.Blocks,
        matches: Sequence[PairMatch],
        prepared: Mapping[str, matching.Prepared],
        pixel: float,
        bare: float,
    ) -> None:
        self.parts, self._pixel, self.bare = (blocks, matches, prepared), pixel, bare
        self.field = blocks.whole
        self.information = elevation.first_information(blocks, matches, pixel, _FREEDOM) / bare

    def estimate(self, modes: Modes) -> elevation.Estimate:
        # noise from the same scores as the field: taken across, what is more along would pass for waves
        return elevation.most_probable(*self.parts, modes, self._pixel, across=False)


class _Shift(_Sample):
    def __init__(
        self, found: matching.Displacement, one: matching.Prepared, other: matching.Prepared, bare: float
    ) -> None:
        self._parts, self.bare = (found, one, other), bare
        self.field = flow.whole(found)
        counts = found.valid.astype(np.float32)
        trace = found.hessian[0] + found.hessian[2]
        nu = matching.noise_of_scores(found.score, trace, counts, _FREEDOM, torn=True)
        self.information = 0.5 * float((trace * counts / nu).mean()) / bare

    def estimate(self, modes: Modes) -> flow.Estimate:
        return flow.most_probable(*self._parts, modes)


@dataclass
class _Samples:
    """Fields of one kind, and the prior that they share."""

    samples: Sequence[_Sample]
    prior: Prior
    pool: ThreadPoolExecutor

    @classmethod
    def of(
        cls, samples: Sequence[_Sample], settings: matching.Settings, pool: ThreadPoolExecutor
    ) -> _Samples:
        shape = samples[0].field.shape[-2:]
        kx, ky = (np.pi * np.arange(n) / n for n in shape[::-1])
        window = matching.transfer_function(settings, kx, ky[:, None]).clip(0, 1)
        fields = [s.field - matching.edge_slopes(s.field) for s in samples]
        typical = float(np.mean([s.information for s in samples]))
        out = cls(samples, matching.first_prior(fields, window, typical), pool)
        for _ in range(_ROUNDS):
            out.prior = out.better(out.prior)
        return out

    def better(self, prior: Prior) -> Prior:
        """The prior that follows from the fields that this one gives."""
        modes = Modes(prior, self.samples[0].field.shape[-2:])
        found = list(self.pool.map(lambda sample: sample.estimate(modes), self.samples))
        information = float(np.mean([f.information.mean() / s.bare for f, s in zip(found, self.samples)]))
        waves = [(f.waves - f.mean) / np.sqrt(s.bare) for f, s in zip(found, self.samples)]
        return matching.better_prior(prior, modes.kx, modes.ky, modes.foot, waves, information)


def _noise_of_waves(prior: Prior, plan: Plan, k: Float) -> Float:
    """Noise in the power of every wave on the grid, by its wavenumber, rad per node."""
    blocks = BLOCK * plan.pixel / plan.grid.step  # from node to node of the lattice
    out: Float = prior.noise_kept(k * blocks) * blocks**2 / np.prod(plan.grid.shape)
    return out


def _matched(record: Record, plan: Plan, k: Float) -> tuple[Float, Float]:
    """What priors leave of waves' displacements, and by how much these are raised; k in rad per node."""
    blocks = k * BLOCK * plan.pixel / plan.grid.step
    gain = np.mean([prior.mean_gain(blocks) for _, prior in record.displacement], axis=0)
    return gain, matching.raised(blocks)


def _elevations(step: tuple[Images, Images], near: _Near, plan: Plan) -> tuple[Float, Float] | None:
    """Elevation at the nodes at two frames, metres."""
    flat, later = (view.flat for view in step)
    if near.pairs is None:
        one = elevation.surface(flat, plan)
    else:
        one = elevation.surface_of(*near.pairs, flat, plan)
    other = elevation.surface(later, plan)
    return None if one is None or other is None else (one.z, other.z)


@dataclass(frozen=True)
class _Differences:
    """What the cameras' differences say in one step.

    `noise` is that of all cameras over what is thought, `own` that of each over that of all, `moved` the
    water's motion, metres, `trembling` that of the cameras, px.
    Where the cameras contradict each other only the last can be told.
    """

    trembling: tuple[float, float]
    noise: float | None = None
    own: Mapping[str, float] = field(default_factory=dict)
    moved: Sequence[float] = ()

    @classmethod
    def of(cls, flows: flow.Flows, z: Float, plan: Plan) -> _Differences | None:
        """From the displacements of one step; None where no node can be told of."""
        steps = (None, flows, None)
        motion = velocity(steps, z, plan)
        if motion is None:
            return None
        names = [name for name in flows if name != motion.left_out]
        seen = look_at_nodes(names, steps, z, plan)
        left, trembling = seen.trembling()
        seen = seen.steadied(left)
        good = np.isfinite(motion.misfit) & ((motion.quality & Quality.FILLED) == 0)
        if not good.any():
            return cls(trembling)
        freedom = 2 * len(names) - 3
        moved = [float(np.std(d[good])) for d in motion.d]
        typical = float(np.median(misfit(seen, np.moveaxis(motion.d, 0, -1))[good]))
        noise = typical / (2 * gammaincinv(freedom / 2, 0.5) / freedom)
        good &= np.isfinite(seen.moved).all(axis=0)
        for where in motion.regions.values():
            good &= ~where
        if not good.any():
            return cls(trembling, noise, {}, moved)
        J = np.moveaxis(seen.jacobian[:, :, good], -1, 0)
        rows = (f[:, good].T for f in (seen.moved, seen.noise_of_each, 1.0 / seen.variance))
        own = dict(zip(names, noise_of_each(J, *rows) / noise, strict=True))
        return cls(trembling, noise, own, moved)


def _misfit(
    views: Sequence[tuple[Images, Images]],
    near: Sequence[_Near],
    heights: Sequence[Float | None],
    plan: Plan,
    pool: ThreadPoolExecutor,
) -> tuple[float, dict[str, float], tuple[float, float, float], tuple[float, float]]:
    """Noise over what is thought: of all cameras, of each beside all; motion of water, m, and cameras, px."""

    def move(view: tuple[Images, Images], found: _Near, z: Float | None) -> _Differences | None:
        if z is None:
            return None
        one, other = (images.raw for images in view)
        flows = {n: flow.flow_near(d, one[n], other[n], plan, n) for n, d in found.displacements.items()}
        return _Differences.of(flows, z, plan)

    found = [one for one in pool.map(move, views, near, heights) if one is not None]
    along, across = np.sqrt(np.mean(np.square([one.trembling for one in found] or [(0.0, 0.0)]), axis=0))
    trembling = float(along), float(across)
    noises = [one.noise for one in found if one.noise is not None]
    if not noises:
        return 1.0, {}, (1.0, 1.0, 1.0), trembling
    found = [one for one in found if one.noise is not None]
    own = own_noise([one.own for one in found])
    moved = np.sqrt(np.mean(np.square([one.moved for one in found]), axis=0))
    x, y, z = np.maximum(moved, _STILL * plan.pixel)
    return float(np.median(noises)), own, (float(x), float(y), float(z)), trembling
