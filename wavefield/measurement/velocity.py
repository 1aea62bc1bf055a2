"""Velocity of the surface water at mid-time, from each camera's own displacements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.camera_displacements import CameraDisplacements, displacements_at_nodes
from wavefield.measurement.flow import Flows
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.measurement_settings import Settings
from wavefield.measurement.node_motion import solve_nodes
from wavefield.measurement.outlier_detection import (
    MAX_MISFIT,
    MAX_NODE_MISFIT,
    median_misfit,
    outlier_camera,
    outlier_regions,
)
from wavefield.variables import Quality

Float = NDArray[np.floating]
Regions = Mapping[str, NDArray[np.bool_]]

_OUTLIER_FRACTION = 0.8  # of the nodes: a camera that contradicts at so many is left out of the step
# Of u, v, w by deep-water waves in all directions: they move the water along as much as up and down.
WAVE_VARIANCES = np.array([0.5, 0.5, 1.0])
_MAX_INCONSISTENT_FRACTION = 0.01  # of the nodes, by chance
_NODES_FOR_MEAN_FLOW = 3000
_WINDOW_REACH_PX = 20  # half a window of the coarse levels


@dataclass(frozen=True)
class Motion:
    """Displacement per step of the surface water at the nodes, at mid-time."""

    d: Float  # (3, ny, nx): (dx, dy, dz), metres; NaN where fewer than two cameras see the node
    noise: Float  # (3, ny, nx): variance of d by noise, and of waves that the prior removes, m^2
    missing: Float
    eps_piv: Float  # (ny, nx): misfit of the cameras' displacements, px
    # (ny, nx): chi^2 of the misfit per degree of freedom; NaN where fewer than two cameras see the node
    misfit: Float
    noise_factor: (
        Float  # (ny, nx): factor on the variance of noise by the misfit, at least 1; NaN as the misfit
    )
    # (ny, nx): bits of `Quality`: why a camera's displacement was rejected; `FILLED` where not enough of them
    # were measured or they contradict each other; `TWO_FRAME_MEAN` where a path has fewer than four places
    quality: NDArray[np.uint16]
    frames: NDArray[np.uint8]  # (ny, nx): places of the paths: 2, 4 or 6, the fewest of all cameras'
    # (3, ny, nx): displacement over the step; mean of the places in its two frames less that at mid-time;
    # metres
    chord: Float
    bend: Float
    left_out: str | None = None  # the camera that contradicted the others, which agree without it
    regions: Regions = field(default_factory=dict)  # (ny, nx): the same in parts of the field

    @property
    def inconsistent(self) -> bool:
        """Whether cameras contradict each other at more than single nodes."""
        against = self.misfit[np.isfinite(self.misfit)] > MAX_MISFIT
        return bool(
            self.left_out or self.regions or against.sum() > _MAX_INCONSISTENT_FRACTION * against.size
        )


def velocity(
    steps: Sequence[Flows | None],
    z: Float,
    geometry: GridGeometry,
    path_frames: int,
    regions: Regions | None = None,
    times: Float | None = None,
) -> Motion | None:
    """Displacement per step of the surface water at the nodes, at mid-time.

    d = argmin sum w (J d - dX)^2, J the 2N x 3 Jacobian at the node's position on the surface z (ny, nx),
    metres, at mid-time, dX the image velocity there (`read_path`): dX/dt = J dx/dt holds exactly, where the
    displacements themselves would need the curvature of the projection. eps' = |J d - dX| / sqrt(2N).

    Noise of the cameras is independent; what the prior removes from a wave all cameras miss alike, so it does
    not shrink when they are averaged: it is shared among the components (`component_variances`). Cameras are
    left out in given regions, or where they are found to contradict the others. Times of the six frames,
    intervals from mid-time, are given where they are uneven.
    """
    names = _cameras(steps)
    if len(names) < 2:
        return None
    displacements = displacements_at_nodes(names, steps, z, geometry, path_frames, times)
    parts = component_variances(geometry.settings)
    motion = solve_motion(displacements, parts)
    measured = (displacements.rejected == 0).all(axis=0)

    @cache
    def by_others(n: int) -> Motion:
        return solve_motion(displacements.without(n), parts)

    def misfit_without(n: int) -> Float:
        return by_others(n).misfit

    outlier = None
    if regions is None:
        reach = max(1, round(_WINDOW_REACH_PX * geometry.pixel / geometry.grid.step))
        found = outlier_regions(motion.misfit, measured, len(names), misfit_without, reach)
        typical = median_misfit(motion.misfit, measured)
        outlier = outlier_camera(len(names), typical, lambda n: median_misfit(misfit_without(n), measured))
        if outlier in found and (found[outlier] & measured).sum() < _OUTLIER_FRACTION * measured.sum():
            outlier = None  # not everywhere
        regions = {names[n]: where for n, where in found.items()} if outlier is None else {}
    if outlier is not None:
        motion = replace(by_others(outlier), left_out=names[outlier])
    for name, where in regions.items():
        motion = _patched(motion, by_others(names.index(name)), where)
    motion = replace(motion, regions=regions)
    # where most contradict each other and no one camera explains it, some nodes agree by chance
    explained = outlier is not None or median_misfit(motion.misfit, measured) <= MAX_MISFIT
    against = motion.misfit > (MAX_NODE_MISFIT if explained else 0.0)
    rejected = np.where(against, np.uint16(Quality.REJECTED_EPS | Quality.FILLED), np.uint16(0))
    return replace(motion, quality=motion.quality | rejected)


def mean_flow(
    steps: Sequence[Flows | None],
    z: Float,
    geometry: GridGeometry,
    path_frames: int,
    times: Float | None = None,
) -> tuple[float, float] | None:
    """Median displacement of the water over the step, (dx, dy), metres, by all cameras at some nodes.
    None if fewer than two cameras have displacements.
    """
    names = _cameras(steps)
    if len(names) < 2:
        return None
    every = max(1, round(np.sqrt(z.size / _NODES_FOR_MEAN_FLOW)))
    displacements = displacements_at_nodes(names, steps, z, geometry, path_frames, times, every)
    chord = solve_motion(displacements, component_variances(geometry.settings)).chord
    measured = np.isfinite(chord).all(axis=0)
    if not measured.any():
        return 0.0, 0.0
    return float(np.median(chord[0][measured])), float(np.median(chord[1][measured]))


def _cameras(steps: Sequence[Flows | None]) -> list[str]:
    return list(steps[len(steps) // 2] or {})


def _patched(motion: Motion, other: Motion, where: NDArray[np.bool_]) -> Motion:
    """One motion with another in a part of the field."""
    names = (
        "d",
        "noise",
        "missing",
        "eps_piv",
        "misfit",
        "noise_factor",
        "quality",
        "frames",
        "chord",
        "bend",
    )
    return replace(motion, **{n: np.where(where, getattr(other, n), getattr(motion, n)) for n in names})


def solve_motion(displacements: CameraDisplacements, parts: Float) -> Motion:
    """Least squares over the cameras; parts are the `component_variances` of what the prior removes."""
    names = ("jacobian", "moved", "chord", "bend", "noise", "missing")
    fields = {name: np.ascontiguousarray(getattr(displacements, name), np.float32) for name in names}
    flat = [f.reshape(*f.shape[:-2], -1) for f in fields.values()]
    shape = displacements.frames.shape
    out = np.empty((16, displacements.frames.size), np.float32)
    solve_nodes(*flat, parts, displacements.axes, out)  # type: ignore[call-arg]
    d, chord, bend, noise = out[:12].reshape(4, 3, *shape)
    removed, eps, misfit, noise_factor = out[12:].reshape(4, *shape)
    accepted = (displacements.rejected == 0).sum(axis=0)
    why = np.bitwise_or.reduce(displacements.rejected & ~np.uint16(Quality.OUTSIDE), axis=0)
    quality = np.where(accepted >= 2, np.uint16(0), why | np.uint16(Quality.FILLED))
    quality |= np.where(displacements.frames < 4, np.uint16(Quality.TWO_FRAME_MEAN), np.uint16(0))
    return Motion(
        d=d,
        noise=noise,
        missing=parts.astype(np.float32)[:, None, None] * removed,
        eps_piv=eps,
        misfit=misfit,
        noise_factor=noise_factor,
        quality=quality,
        frames=displacements.frames,
        chord=chord,
        bend=bend,
    )


def component_variances(settings: Settings) -> Float:
    """Relative variances of u, v, w that the prior removes: of waves, or all alike in a light sheet."""
    return WAVE_VARIANCES if settings.sheet_thickness is None else np.ones(3)


def image_variance(displacements: CameraDisplacements, parts: Float) -> Float:
    """Variance in each camera's image, (N, ny, nx), px^2, of motion whose components vary by parts, m^2.
    It is the mean of both components of the image.
    """
    square = np.einsum("kiyx,i->kyx", np.square(displacements.jacobian), parts)
    return np.asarray(0.5 * (square[::2] + square[1::2]))
