"""What the differences between the cameras of a sample step say of noise, waves and their own motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from wavefield import matching
from wavefield.measurement.each_camera import noise_of_each, own_noise
from wavefield.measurement.flow import Flows
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.model import Model
from wavefield.measurement.velocity import (
    CameraDisplacements,
    displacements_at_nodes,
    misfit,
    shares,
    signal,
    velocity,
)
from wavefield.rig.stereo import solve_displacement
from wavefield.variables import Quality

Float = NDArray[Any]

_STILL = 1e-3  # of the pixel: the least motion from frame to frame that water is thought to have


@dataclass(frozen=True)
class Differences:
    """What the cameras' differences say."""

    # (float, float): Motion of the cameras' pictures from frame to frame, along their line and across it, px
    camera_jitter: tuple[float, float]
    determined: bool = False  # Whether anything else can be told: not where the cameras contradict each other
    noise: float = 1.0  # Noise of all cameras over what is thought
    own: Mapping[str, float] = field(default_factory=dict)  # Noise of each camera over that of all
    # (float, float, float): Standard deviation of the water's motion from frame to frame, metres
    moved: tuple[float, float, float] = (1.0, 1.0, 1.0)
    # Fraction of the displacements' spectra that is waves: what the cameras have in common (`Prior.waves`)
    waves: float = 1.0
    scatter: float = 0.0  # Variance by noise of dx, dy and dz of the water together, m^2


def differences(flows: Flows, z: Float, geometry: GridGeometry, model: Model) -> Differences | None:
    """What the cameras' differences say of one step.

    With z (ny, nx), metres.
    """
    steps = (None, flows, None)
    motion = velocity(steps, z, geometry, model.record)
    if motion is None:
        return None
    names = [name for name in flows if name != motion.left_out]
    seen = displacements_at_nodes(names, steps, z, geometry, model.record)
    left, camera_jitter = seen.camera_jitter()
    seen = seen.stabilized(left)
    good = np.isfinite(motion.misfit) & ((motion.quality & Quality.FILLED) == 0)
    if not good.any():
        return Differences(camera_jitter)
    freedom = 2 * len(names) - 3
    x, y, up = (float(np.std(d[good])) for d in motion.d)
    typical_misfit = float(np.median(misfit(seen, np.moveaxis(motion.d, 0, -1))[good]))
    noise = typical_misfit / (2 * gammaincinv(freedom / 2, 0.5) / freedom)
    good &= np.isfinite(seen.moved).all(axis=0)
    for where in motion.regions.values():
        good &= ~where
    found = Differences(camera_jitter, True, noise, {}, (x, y, up))
    if not good.any():
        return found
    J = np.moveaxis(seen.jacobian[:, :, good], -1, 0)
    rows = (f[:, good].T for f in (seen.moved, seen.noise_of_each, 1.0 / seen.variance))
    own = dict(zip(names, noise_of_each(J, *rows) / noise, strict=True))
    waves, scatter = _in_common(J, seen, names, good, noise, shares(geometry.settings, model.record), model)
    return replace(found, own=own, waves=waves, scatter=scatter)


def _in_common(
    J: Float,
    seen: CameraDisplacements,
    names: Sequence[str],
    good: NDArray[np.bool_],
    noise: float,
    parts: Float,
    model: Model,
) -> tuple[float, float]:
    """Fraction of the displacements' spectra that is waves: noise of the cameras is smaller in their mean.

    And that noise: variance of dx, dy and dz together.
    """
    rows = (np.sqrt(f[:, good].T) for f in (seen.variance, noise * seen.noise_of_each))
    d, _, d_std = solve_displacement(J, seen.moved[:, good].T, *rows)
    each = signal(seen, parts)[:, good].mean(axis=1)
    brought = [
        model.displacement[name].prior.variances(model.displacement[name].modes.lattice)[0].mean() / one
        for name, one in zip(names, each, strict=True)
    ]
    waves = float(np.mean(brought) * parts.sum())
    scatter = float(np.square(d_std).mean(axis=0).sum())
    return matching.shrinkage(float(np.var(d, axis=0).sum()), scatter, waves), scatter


def typical(steps: Sequence[Differences], pixel: float) -> Differences:
    """What the differences of several steps say together.

    With pixel, metres.
    """
    along, across = np.sqrt(np.mean(np.square([one.camera_jitter for one in steps] or [(0.0, 0.0)]), axis=0))
    camera_jitter = float(along), float(across)
    steps = [one for one in steps if one.determined]
    if not steps:
        return Differences(camera_jitter)
    moved = np.sqrt(np.mean(np.square([one.moved for one in steps]), axis=0))
    x, y, z = np.maximum(moved, _STILL * pixel)
    noise, waves, scatter = (
        float(np.median(part)) for part in zip(*((one.noise, one.waves, one.scatter) for one in steps))
    )
    own = own_noise([one.own for one in steps])
    return Differences(camera_jitter, True, noise, own, (float(x), float(y), float(z)), waves, scatter)
