"""Estimate the most probable (MAP) displacement of one camera's image from one frame to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wavefield import matching
from wavefield.matching.blocks import noise_of_scores, trust_in_scores
from wavefield.matching.blocks import slopes as slopes_of
from wavefield.matching.map_field import Modes
from wavefield.matching.pyramid import reevaluate
from wavefield.matching.spectrum import averaged
from wavefield.measurement.elevation import why_rejected
from wavefield.measurement.model import MAX_EVALUATIONS, Convergence, FieldModel, Model
from wavefield.measurement.regrid import push_pull
from wavefield.variables import Quality

Float = NDArray[np.floating]

# Largest variance of matched displacements over that in the sample steps. Above it, the learned spectra
# suppress more of the waves than the uncertainties account for.
MAX_MOTION_RATIO = 16.0
MIN_TRUST = 0.5  # least weight (`trust_in_scores`) of a block that counts as measured
STILL_WATER_VARIANCE = 8e-4  # px^2: lower bound of the variance in the sample steps, for this ratio


@dataclass(frozen=True)
class CameraFlow:
    """Displacement of one camera's image from one frame to the next, as a spline with variances."""

    spline: Float  # (ny, nx, 2): spline coefficients on the lattice of blocks, px of the binned image
    noise: Float  # (1 or 2, ny, nx): variance due to noise, px^2, common to both components or of each
    missing: Float  # (1 or 2, ny, nx): variance of waves that the prior suppresses, px^2
    rejected: NDArray[np.uint16]  # (ny, nx): bits of `Quality`; 0 where measured

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Mask (ny, nx), True for blocks that were measured."""
        return np.asarray(self.rejected == 0)


Flows = Mapping[str, CameraFlow]


@dataclass
class FlowEstimate:
    """Most probable (MAP) displacement between two frames: cosine series + smooth field + second harmonic."""

    waves: Float  # (2, my, mx): cosine coefficients, px
    edges: Float = field(repr=False)  # (2, ny, nx): smooth part (`Modes.split`), px
    harmonics: Float = field(repr=False)  # (2, ny, nx): second-harmonic correction, px (`harmonics`)
    each: Float = field(repr=False)  # (2, ny, nx): diagonal of the information A of every block, px^-2
    # scores of the blocks at the last evaluation, and the reasons why blocks were rejected
    found: matching.Displacement = field(repr=False)

    @property
    def information(self) -> Float:
        """Inverse variance of the displacement of each block, averaged over u and v, (ny, nx), px^-2."""
        return np.asarray(np.float32(0.5) * (self.each[0] + self.each[1]))


def filled(found: matching.Displacement) -> Float:
    """Return u and v of a match, (2, ny, nx), px; invalid blocks get averages of the blocks around them."""
    return push_pull(np.stack([found.u, found.v]), found.valid)


def harmonics(midway: Float) -> Float:
    """Return displacements at start points minus those at midpoints, (D . grad) D / 2, (2, ny, nx), px.
    D = `midway` (2, ny, nx), px, are displacements at their midpoints. The mean of the D before grad is
    subtracted, because a uniform displacement only shifts waves."""
    x, y = midway
    xx, xy, yx, yy = slopes_of(x, y)
    x, y = x - x.mean(), y - y.mean()
    return np.asarray(np.float32(0.5) * np.stack([x * xx + y * xy, x * yx + y * yy]))


def map_displacement(
    match: matching.Displacement,
    one: matching.PreparedImage,
    other: matching.PreparedImage,
    modes: Modes,
    with_harmonics: bool = False,
) -> FlowEstimate:
    """Estimate the most probable (MAP) displacement from image `one` to image `other`, starting from `match`.
    With `with_harmonics`, add the correction `harmonics`; fields are too noisy for it in learning spectra."""
    found = match
    u = filled(match)
    edges, waves = modes.split(u)
    block_mean, a, not_in_modes, harmonic = None, u, edges, np.zeros_like(u)
    convergence = Convergence()
    for number in range(MAX_EVALUATIONS):
        if number:
            if with_harmonics:
                before, harmonic = harmonic, harmonics(modes.field(waves) + edges)
                waves = waves - modes.waves(harmonic - before)
                block_mean = modes.block_mean(waves)
                not_in_modes = edges + averaged(harmonic, modes.prior.area)
            u = block_mean + not_in_modes
            found = reevaluate(one, other, u[0], u[1], match.settings)
        counts = found.valid.astype(np.float32)
        trace = found.hessian[0] + found.hessian[2]
        if number:
            trust = trust_in_scores(found.score, trace, counts)
            outlier = (trust < MIN_TRUST) * np.uint8(matching.Reason.NEIGHBOURS)
            found, counts = replace(found, reason=found.reason | outlier), counts * trust
        nu = noise_of_scores(found.score, trace, counts, modes.freedom, with_mismatches=True)
        counts /= nu * np.float32(modes.prior.noise)
        a = found.hessian * counts
        right = found.score * counts
        x, y = u - not_in_modes
        right[0] += a[0] * x + a[1] * y
        right[1] += a[1] * x + a[2] * y
        if not number:
            information = np.float32(0.5) * (a[0] + a[2])
            factor, tolerances = modes.factor(information), modes.tolerances(information)
        solved = modes.solve(a, right, waves, tolerances[min(number, 1)], factor, block_mean)
        waves, block_mean = convergence.next(modes, waves, solved, block_mean)
        if convergence.converged:
            break
    return FlowEstimate(waves, edges, harmonic, a[::2], found)


def flows(
    first: Mapping[str, matching.PreparedImage],
    second: Mapping[str, matching.PreparedImage],
    settings: matching.MatchSettings,
    model: Model,
) -> dict[str, CameraFlow]:
    """Return, by camera, the most probable (MAP) displacement from its first to its second image.
    Cameras without one of the images are left out. All blocks of a camera are rejected as out of range if its
    image moves far more than in the sample steps from which `model` was learned."""
    out, learned = {}, dict(model.record.motion)
    for name in first:
        if name in second:
            near = matching.match(first[name], second[name], settings)
            estimator = model.displacement[name]
            found = map_displacement(near, first[name], second[name], estimator.modes, True)
            flow = camera_flow(found, estimator)
            usual = max(learned.get(name, np.inf), STILL_WATER_VARIANCE)
            if motion_variance(near) > MAX_MOTION_RATIO * usual:
                flow = replace(flow, rejected=flow.rejected | np.uint16(Quality.REJECTED_RANGE))
            out[name] = flow
    return out


def motion_variance(found: matching.Displacement) -> float:
    """Return the sum of the variances of u and v over valid blocks, px^2; 0 if no block is valid."""
    valid = found.valid
    return float(np.var(found.u[valid]) + np.var(found.v[valid])) if valid.any() else 0.0


def camera_flow(found: FlowEstimate, model: FieldModel) -> CameraFlow:
    """Convert the estimate `found` to spline coefficients, for interpolation, and add its variances."""
    noise, missing = model.spread(found.information)
    spline = model.splined(found.waves, found.edges + found.harmonics)
    return CameraFlow(spline, noise, missing, why_rejected(found.found.reason))
