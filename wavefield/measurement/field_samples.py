"""Sample fields of a record, and the prior spectrum that they share: each follows from the other."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.matching import Modes, Prior
from wavefield.matching.matching_gain import FOOTPRINT_VARIANCE
from wavefield.matching.noise import hole_mask
from wavefield.matching.prior import FIRST_SIGNAL_TO_NOISE, OPEN_SIGNAL_TO_NOISE
from wavefield.measurement.flow import FlowEstimate, filled, map_displacement
from wavefield.measurement.map_elevation import (
    Blocks,
    ElevationEstimate,
    PreparedImages,
    combine,
    first_information,
    map_elevation,
)
from wavefield.measurement.pair_surface import PairMatch

Float = NDArray[np.floating]

_ROUNDS = 2  # of spectrum and field in turn
_HALF_WITHIN = 0.6745  # standard deviations of a Gaussian; of half of a field, so that edges do not count
_RANDOM_SIGNAL_TO_NOISE = 10.0  # amplitude of random waves
_TOLERANCE = 0.03  # of the solver (`Modes.solve`)
_FREEDOM = 0.6  # fraction of the scores' noise that windows leave in them, about


class FieldSample(Protocol):
    """One field: as windows give it, and as a prior makes it; `bare` is the fraction of blocks not masked.
    `information` is the mean of these: below a mask the water is assumed to be as rough and as visible.
    `area` is that of `Prior`.
    """

    field: Float
    information: float
    bare: float
    area: float

    def estimate(self, modes: Modes) -> ElevationEstimate | FlowEstimate:
        """The MAP field."""

    def noise(self, modes: Modes) -> tuple[Float, float] | None:
        """Coefficients of a field of noise alone and its information, where the cameras show one."""


class ElevationSample:
    """Elevation of one instant from matched pairs; pixel in metres."""

    area = FOOTPRINT_VARIANCE

    def __init__(
        self,
        blocks: Blocks,
        matches: Sequence[PairMatch],
        prepared: PreparedImages,
        pixel: float,
        bare: float,
    ) -> None:
        self.blocks, self.matches, self.prepared, self.pixel, self.bare = (
            blocks,
            matches,
            prepared,
            pixel,
            bare,
        )
        self.field = blocks.filled
        self.information = first_information(blocks, matches, pixel, _FREEDOM) / bare

    def estimate(self, modes: Modes) -> ElevationEstimate:
        """The MAP elevation, with the noise from the same scores as the field.
        With the noise across, an excess along would count as waves.
        """
        return map_elevation(self.blocks, self.matches, self.prepared, modes, self.pixel, noise_across=False)

    def noise(self, modes: Modes) -> tuple[Float, float] | None:
        """As if the sight lines were turned by a quarter: no wave moves anything across them."""
        turned = [m.turned for m in self.matches]
        found = map_elevation(combine(turned), turned, self.prepared, modes, self.pixel, noise_across=False)
        information = float(found.information.mean()) / self.bare
        return ((found.waves) / np.sqrt(self.bare), information) if information > 0 else None

    def summary(self, modes: Modes) -> tuple[float, float, float]:
        """Information of a block, variance of z, and of the smooth epipolar error, square metres."""
        found = map_elevation(self.blocks, self.matches, self.prepared, modes, self.pixel)
        z = modes.field(found.waves)[0][found.information > 0]
        std = float(np.median(np.abs(z - np.median(z)))) / _HALF_WITHIN if z.size else 0.0
        return float(found.information.mean()) / self.bare, std**2, found.epipolar**2


class DisplacementSample:
    """Displacement of one camera's image between two frames."""

    def __init__(
        self,
        found: matching.Displacement,
        one: matching.PreparedImage,
        other: matching.PreparedImage,
        bare: float,
        area: float,
    ) -> None:
        self.match, self._images, self.bare, self.area = found, (one, other), bare, area
        self.field = filled(found)
        counts = found.valid.astype(np.float32)
        trace = found.hessian[0] + found.hessian[2]
        nu = matching.noise_of_scores(found.score, trace, counts, _FREEDOM, with_mismatches=True)
        self.information = 0.5 * float((trace * counts / nu).mean()) / bare

    def estimate(self, modes: Modes) -> FlowEstimate:
        """The MAP displacement."""
        return map_displacement(self.match, *self._images, modes)

    def noise(self, modes: Modes) -> tuple[Float, float] | None:
        """None: one camera alone shows no noise without waves."""
        return None


@dataclass(frozen=True)
class OpenFields:
    """The samples' fields under a prior that suppresses no wave."""

    prior: Prior
    modes: Modes
    found: Sequence[ElevationEstimate | FlowEstimate]
    noise: Sequence[tuple[Float, float]]  # fields of noise alone, where cameras show it
    kept: Sequence[tuple[Float, Float]]  # power of random fields, and the part that blocks keep of it


@dataclass
class FieldSamples:
    """Fields of one kind, and the prior that they share."""

    samples: Sequence[FieldSample]
    prior: Prior
    pool: ThreadPoolExecutor
    opened: OpenFields = field(init=False)  # from which the prior follows

    @classmethod
    def of(
        cls, samples: Sequence[FieldSample], settings: matching.MatchSettings, pool: ThreadPoolExecutor
    ) -> FieldSamples:
        """Start from the spectrum of the windowed fields over the windows' gain."""
        kx, ky = (np.pi * np.arange(n) / n for n in samples[0].field.shape[:-3:-1])
        window = matching.transfer_function(settings, kx, ky[:, None]).clip(0, 1)
        fields = [s.field - matching.edge_field(s.field) for s in samples]
        typical = float(np.mean([s.information for s in samples]))
        out = cls(samples, matching.first_prior(fields, window, typical, samples[0].area), pool)
        for number in range(_ROUNDS):
            ratio = OPEN_SIGNAL_TO_NOISE if number else FIRST_SIGNAL_TO_NOISE
            out.opened = out.open(out.prior, ratio)
            out.prior = out.better(out.opened)
        return out

    def open(self, prior: Prior, ratio: float = OPEN_SIGNAL_TO_NOISE) -> OpenFields:
        """Fields with at least this signal over noise assumed of every wave."""
        prior = prior.with_min_signal_to_noise(ratio)
        modes = Modes(prior, self.samples[0].field.shape[-2:])
        found = list(self.pool.map(lambda sample: sample.estimate(modes), self.samples))
        noise = [part for part in self.pool.map(lambda sample: sample.noise(modes), self.samples) if part]
        return OpenFields(prior, modes, found, noise, list(self.pool.map(partial(_kept, modes), found)))

    def better(self, opened: OpenFields, common: Float | None = None) -> Prior:
        """The prior that follows from open fields, and from what waves cameras have in common."""
        found, modes = opened.found, opened.modes
        information = float(np.mean([f.information.mean() / s.bare for f, s in zip(found, self.samples)]))
        waves = [f.waves / np.sqrt(s.bare) for f, s in zip(found, self.samples)]
        band = modes.kx, modes.ky, modes.foot
        known = opened.noise, common, opened.kept
        return matching.better_prior(opened.prior, *band, waves, information, *known)


def _kept(modes: Modes, found: ElevationEstimate | FlowEstimate) -> tuple[Float, Float]:
    """Power of random waves, all lengths alike, outside holes, and the part that blocks keep."""
    each = found.each if isinstance(found, FlowEstimate) else found.information[None]
    a = np.stack([each[0], np.zeros_like(each[0]), each[1]]) if len(each) == 2 else each
    size = np.float32(_RANDOM_SIGNAL_TO_NOISE / np.sqrt(modes.prior.information))
    waves = size * np.random.default_rng(0).standard_normal((len(each), *modes.shape), np.float32)
    nothing = np.zeros_like(waves)
    right, factor = each * modes.seen(waves), modes.factor(found.information)
    kept = modes.solve(a, right, nothing, _TOLERANCE, factor)
    there = modes.waves(modes.field(waves) * ~hole_mask(found.information, modes.prior.information))
    return there * waves, there * kept
