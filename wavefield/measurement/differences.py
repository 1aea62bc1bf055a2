"""Noise, waves and camera motion of a sample step, from the differences between the cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from wavefield import matching
from wavefield.measurement.camera_displacements import CameraDisplacements, displacements_at_nodes
from wavefield.measurement.each_camera import noise_of_each, own_noise
from wavefield.measurement.flow import Flows
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.model import Model
from wavefield.measurement.unresolved_waves import InCommon
from wavefield.measurement.velocity import image_variance, shares, solve_motion, velocity
from wavefield.rig.stereo import solve_displacement
from wavefield.variables import Quality

Float = NDArray[np.floating]

_MIN_MOTION_PX = 1e-3  # of the water from frame to frame, that is assumed


@dataclass(frozen=True)
class Differences:
    """What the cameras' differences show."""

    camera_jitter: tuple[float, float]  # motion from frame to frame, along their row and across it, px
    determined: bool = False  # the rest: not where the cameras contradict each other
    noise: float = 1.0  # of all cameras over the prior's
    own: Mapping[str, float] = field(default_factory=dict)  # noise of each camera over that of all
    moved: tuple[float, float, float] = (
        1.0,
        1.0,
        1.0,
    )  # std of the water's motion from frame to frame, metres
    waves: float = 1.0  # fraction of the displacements' spectra that all cameras share (`Prior.waves`)
    noise_variance: float = 0.0  # of dx, dy and dz of the water together, square metres
    in_common: tuple[InCommon, ...] = ()


def differences(flows: Flows, z: Float, geometry: GridGeometry, model: Model) -> Differences | None:
    """Differences between the cameras in one step, on the surface z (ny, nx), metres."""
    steps = (None, flows, None)
    motion = velocity(steps, z, geometry, model.record)
    if motion is None:
        return None
    names = [name for name in flows if name != motion.left_out]
    moved = displacements_at_nodes(names, steps, z, geometry, model.record)
    residuals, camera_jitter = moved.camera_jitter()
    moved = moved.stabilized(residuals)
    good = np.isfinite(motion.misfit) & ((motion.quality & Quality.FILLED) == 0)
    if not good.any():
        return Differences(camera_jitter)
    freedom = 2 * len(names) - 3
    x, y, up = (float(np.std(d[good])) for d in motion.d)
    parts = shares(geometry.settings, model.record)
    stabilized = solve_motion(moved, parts, model.record)
    misfit = stabilized.misfit[good & np.isfinite(stabilized.misfit)]  # NaN where cameras lost a path
    if not misfit.size:
        return Differences(camera_jitter)
    noise = float(np.median(misfit)) / (2 * gammaincinv(freedom / 2, 0.5) / freedom)
    good &= np.isfinite(moved.moved).all(axis=0)
    for where in motion.regions.values():
        good &= ~where
    found = Differences(camera_jitter, True, noise, {}, (x, y, up))
    if not good.any():
        return found
    J = np.moveaxis(moved.jacobian[:, :, good], -1, 0).astype(np.float64)
    rows = (f[:, good].T for f in (moved.moved, moved.noise_of_each, 1.0 / moved.variance))
    own = dict(zip(names, noise_of_each(J, *rows) / noise, strict=True))
    waves, noise_variance = _waves_in_common(J, moved, names, good, noise, parts, model)
    return replace(found, own=own, waves=waves, noise_variance=noise_variance)


def _waves_in_common(
    J: Float,
    moved: CameraDisplacements,
    names: Sequence[str],
    good: NDArray[np.bool_],
    noise: float,
    parts: Float,
    model: Model,
) -> tuple[float, float]:
    """Fraction of the displacements' spectra that is waves, and the noise variance of dx, dy, dz together.
    Noise of the cameras is smaller in their mean, which waves are not.
    """
    rows = (np.sqrt(f[:, good].T) for f in (moved.variance, noise * moved.noise_of_each))
    d, d_std = solve_displacement(J, moved.moved[:, good].T, *rows)
    each = image_variance(moved, parts)[:, good].mean(axis=1)
    fields = [model.displacement[name] for name in names]
    prior_variance = [
        field.prior.variances(field.modes.lattice)[0].mean() / one
        for field, one in zip(fields, each, strict=True)
    ]
    waves = float(np.mean(prior_variance) * parts.sum())
    noise_variance = float(np.square(d_std).mean(axis=0).sum())
    return matching.shrinkage(float(np.var(d, axis=0).sum()), noise_variance, waves), noise_variance


def typical_differences(steps: Sequence[Differences], pixel: float) -> Differences:
    """Differences of several steps together; pixel in metres."""
    along, across = np.sqrt(np.mean(np.square([one.camera_jitter for one in steps] or [(0.0, 0.0)]), axis=0))
    camera_jitter = float(along), float(across)
    steps = [one for one in steps if one.determined]
    if not steps:
        return Differences(camera_jitter)
    moved = np.sqrt(np.mean(np.square([one.moved for one in steps]), axis=0))
    x, y, z = np.maximum(moved, _MIN_MOTION_PX * pixel)
    noise, waves, noise_variance = (
        float(np.median(part)) for part in zip(*((one.noise, one.waves, one.noise_variance) for one in steps))
    )
    own = own_noise([one.own for one in steps])
    in_common = tuple(part for one in steps for part in one.in_common)
    moved_by_water = float(x), float(y), float(z)
    return Differences(camera_jitter, True, noise, own, moved_by_water, waves, noise_variance, in_common)
