"""Velocity of the surface water at mid-time, from each camera's own displacements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.camera_jitter import left_over, line_of, of_the_water
from wavefield.measurement.flow import CameraFlow, Flows
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.learned_record import LearnedRecord
from wavefield.measurement.measurement_settings import Settings
from wavefield.measurement.outlier_detection import MISFIT, NODE, median_misfit, outlier_camera, regions
from wavefield.measurement.paths import five, noise_weights, read_path
from wavefield.measurement.sight import Sight
from wavefield.rig.stereo import solve_displacement
from wavefield.variables import Quality

Float = NDArray[Any]

_WHOLE = 0.8  # of the nodes: a camera that contradicts at so many is left out of the step
_SHORT_WAVES = 0.5, 0.5, 1.0  # variance of u, v, w in deep water, where the prior takes from waves
_SINGLE = 0.01  # of the nodes: so few may contradict each other by themselves
_REACH = 20  # px: half a window of the coarse levels, by which what a camera shows at one place is felt


@dataclass(frozen=True)
class Motion:
    """Displacement per step of the surface water at the nodes, at mid-time."""

    # (3, ny, nx): (dx, dy, dz) and its standard uncertainty, metres; NaN where fewer than two cameras see the
    # node
    d: NDArray[Any]
    d_std: NDArray[Any]
    eps_piv: NDArray[Any]  # (ny, nx): Misfit of the cameras' displacements, px
    # (ny, nx): Squared misfit over what noise lets expect, per degree of freedom; NaN where fewer than two
    # see it
    misfit: NDArray[Any]
    # (ny, nx): Bits of `Quality`: why a camera's displacement was rejected; `FILLED` where not enough of them
    # were measured or they contradict each other; `TWO_FRAME_MEAN` where a path has fewer than four places
    quality: NDArray[np.uint16]
    frames: NDArray[np.uint8]  # (ny, nx): Places that paths have: 2, 4 or 6, the fewest of all cameras'
    # (3, ny, nx): Displacement over the step; mean of the places in its two frames less that at mid-time;
    # metres
    chord: NDArray[Any]
    bend: NDArray[Any]
    left_out: str | None = None  # The camera that contradicted the others, which agree without it
    # (ny, nx): Where a camera contradicted the others, which agree there without it
    regions: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)

    @property
    def inconsistent(self) -> bool:
        """Whether cameras contradict each other at more than single nodes."""
        against = self.misfit[np.isfinite(self.misfit)] > MISFIT
        return bool(self.left_out or self.regions or against.sum() > _SINGLE * against.size)


@dataclass(frozen=True)
class CameraDisplacements:
    """What each of N cameras has at the nodes."""

    jacobian: Float  # (2N, 3, ny, nx): Px per metre
    # (2N, ny, nx): Displacement per step at mid-time, px; NaN where the camera does not see the node
    moved: Float
    noise: Float  # (2N, ny, nx): Variance by noise, and by what the prior takes away or makes up, px^2
    missing: Float
    # (2N,): Factors on the noise of every component: that of a camera's two, that of the camera beside the
    # others
    along: Float
    own: Float
    rejected: NDArray[np.uint16]  # (N, ny, nx): Why not measured: bits of `Quality`; `OUTSIDE` where not seen
    frames: NDArray[np.uint8]  # (ny, nx): Places that paths have: 2, 4 or 6, the fewest of all cameras'
    line: Float  # (2,): Direction along which the cameras stand
    # (2N, ny, nx): Displacement over the step, and the mean of the places in its two frames less that at mid-
    # time, px
    chord: Float
    bend: Float
    # (N, 3): Direction in which each camera is directed over its distance from the middle of the field, 1/m
    axes: Float

    @property
    def determined(self) -> NDArray[np.bool_]:
        """Nodes that all cameras measured, (ny, nx)."""
        return np.asarray((self.rejected == 0).all(axis=0) & np.isfinite(self.moved).all(axis=0))

    def camera_jitter(self) -> tuple[Float, tuple[float, float]]:
        """What the cameras leave on the mean over the field, px, and how far they move (`left_over`)."""
        return left_over(self.jacobian, self.moved, 1.0 / self.variance, self.determined, self.line)

    def stabilized(self, left: Float) -> CameraDisplacements:
        """The same with what is left on the mean over the field taken off."""
        return replace(self, moved=self.moved - left[:, None, None])

    @property
    def noise_of_each(self) -> Float:
        """Variance by noise of every component, (2N, ny, nx)."""
        out: Float = self.noise * (self.along * self.own)[:, None, None]
        return out

    @property
    def variance(self) -> Float:
        """What every component is weighed by, (2N, ny, nx): the mean of the variances of its camera's two.

        Without their own factors and the camera's: those are for what is stated.
        """
        both = 0.5 * (self.noise[::2] + self.noise[1::2] + self.missing[::2] + self.missing[1::2])
        out: Float = np.repeat(both, 2, axis=0)
        return out


def velocity(
    steps: Sequence[Flows | None],
    z: NDArray[Any],
    geometry: GridGeometry,
    record: LearnedRecord,
    without: Mapping[str, NDArray[np.bool_]] | None = None,
    unsteady: float = 0.0,
) -> Motion | None:
    """Displacement per step of the surface water at the nodes, at mid-time.

    d = argmin sum w (J d - dX)^2, J the 2N x 3 Jacobian at the node's position on the surface at mid-time, dX
    the image velocity there (`read_path`): dX/dt = J dx/dt holds exactly, where the displacements themselves
    would ask for the curvature of the projection. eps' = |J d - dX| / sqrt(2N).

    Noise of the cameras is independent; what the prior takes from a wave all cameras miss alike, so it does
    not shrink when they are averaged: it is shared among the components as a short wave of any direction
    moves the water, half as much along x and along y as up and down (its variance); in a light sheet as the
    fluid's own motion is. Motion of the cameras themselves all nodes share (`trembling`).

    With z (ny, nx), metres; without (ny, nx); unsteady, px.
    """
    names = _cameras(steps)
    if len(names) < 2:
        return None
    seen = displacements_at_nodes(names, steps, z, geometry, record)
    parts = shares(geometry.settings, record)
    motion = _solved(seen, parts, record, unsteady)
    known = (seen.rejected == 0).all(axis=0)

    @cache
    def by_others(n: int) -> Motion:
        return _solved(_others(seen, n), parts, record, unsteady)

    def misfit_without(n: int) -> Float:
        return by_others(n).misfit

    outlier = None
    if without is None:
        reach = max(1, round(_REACH * geometry.pixel / geometry.grid.step))
        found = regions(motion.misfit, known, len(names), misfit_without, reach)
        typical = median_misfit(motion.misfit, known)
        outlier = outlier_camera(len(names), typical, lambda n: median_misfit(misfit_without(n), known))
        if outlier in found and (found[outlier] & known).sum() < _WHOLE * known.sum():
            outlier = None  # not everywhere
        without = {names[n]: where for n, where in found.items()} if outlier is None else {}
    if outlier is not None:
        motion = replace(by_others(outlier), left_out=names[outlier])
    for name, where in without.items():
        motion = _patched(motion, by_others(names.index(name)), where)
    motion = replace(motion, regions=without)
    typical = median_misfit(motion.misfit, known)
    # where most contradict each other and no one camera explains it, some nodes agree by chance
    limit = NODE if outlier is not None or typical <= MISFIT else 0.0
    against = np.where(motion.misfit > limit, np.uint16(Quality.REJECTED_EPS | Quality.FILLED), np.uint16(0))
    return replace(motion, quality=motion.quality | against)


def motion_at(
    steps: Sequence[Flows | None], z: NDArray[Any], geometry: GridGeometry, record: LearnedRecord
) -> Motion | None:
    """As `velocity`, by all cameras, whether they contradict each other or not."""
    names = _cameras(steps)
    if len(names) < 2:
        return None
    seen = displacements_at_nodes(names, steps, z, geometry, record)
    return _solved(seen, shares(geometry.settings, record), record)


def _cameras(steps: Sequence[Flows | None]) -> list[str]:
    return list(steps[len(steps) // 2] or {})


def _patched(motion: Motion, other: Motion, where: NDArray[np.bool_]) -> Motion:
    """One motion with another in a part of the field."""
    names = ("d", "d_std", "eps_piv", "misfit", "quality", "frames", "chord", "bend")
    return replace(motion, **{n: np.where(where, getattr(other, n), getattr(motion, n)) for n in names})


def _others(seen: CameraDisplacements, n: int) -> CameraDisplacements:
    """The same without one camera."""
    rows = [i for i in range(len(seen.moved)) if i // 2 != n]
    cameras = [i for i in range(len(seen.rejected)) if i != n]
    of_rows = ("jacobian", "moved", "noise", "missing", "along", "own", "chord", "bend")
    parts = {name: getattr(seen, name)[rows] for name in of_rows}
    return replace(seen, **parts, rejected=seen.rejected[cameras], axes=seen.axes[cameras])


def displacements_at_nodes(
    names: Sequence[str],
    steps: Sequence[Flows | None],
    z: NDArray[Any],
    geometry: GridGeometry,
    record: LearnedRecord,
) -> CameraDisplacements:
    """What each camera has at the nodes."""
    count, shape = len(names), z.shape
    jacobian = np.empty((2 * count, 3, *shape), np.float64)
    moved, chord, bend = np.empty((3, 2 * count, *shape), np.float64)
    noise, missing = np.empty((2, 2 * count, *shape), np.float64)
    rejected = np.empty((count, *shape), np.uint16)
    along, own = np.ones((2, 2 * count))
    frames = np.full(shape, 6, np.uint8)
    axes = np.empty((count, 3))
    middle = np.array([np.mean(geometry.x), np.mean(geometry.y), 0.0])
    for n, name in enumerate(names):
        sight = geometry.sights[name]
        at = sight.at(z)
        X, Y = at[0], at[1]
        inside = sight.sees(X, Y)
        X, Y = np.where(inside, X, np.float32(np.nan)), np.where(inside, Y, np.float32(np.nan))
        path = [None if f is None else f.get(name) for f in steps]
        rows = slice(2 * n, 2 * n + 2)
        jacobian[rows] = at[2:].reshape(2, 3, *shape)
        found, block, noise[rows], missing[rows] = _along_path(path, sight, X, Y)
        moved[rows], chord[rows], bend[rows] = found[:2], found[2:4], found[4:]
        axes[n] = sight.camera.R[2] / (sight.camera.R[2] @ middle + sight.camera.T[2])
        here = path[len(path) // 2]
        assert here is not None
        along[rows] = here.along
        own[rows] = record.own_noise(name)
        rejected[n] = np.where(inside, here.rejected.ravel()[block[2]], np.uint16(Quality.OUTSIDE))
        frames = np.where(inside, np.minimum(frames, _frames_of(block)), frames)
    line = line_of([geometry.rig[name].centre for name in names])
    return CameraDisplacements(
        jacobian, moved, noise, missing, along, own, rejected, frames, line, chord, bend, axes
    )


def _along_path(
    path: Sequence[CameraFlow | None], sight: Sight, X: NDArray[Any], Y: NDArray[Any]
) -> tuple[Float, NDArray[np.int64], Float, Float]:
    """Path of one camera at given pixels (`read_path`), blocks read, noise, what is missing."""
    here = path[len(path) // 2]
    assert here is not None
    splines = [None if f is None else f.spline for f in path]
    valid = [None if f is None else f.valid for f in path]
    d, block = read_path(splines, valid, sight.lattice, X, Y)
    each = {
        at: _at_blocks(flow.noise, np.maximum(block[at], 0)) for at, flow in zip(range(5), five(path)) if flow
    }
    frames, noise = _frames_of(block), each[2]
    for places in (4, 6):
        if not (frames == places).any():
            continue
        own, *beside = noise_weights(places)
        both = sum(np.float32(w) * (each[2 - n] + each[2 + n]) for n, w in enumerate(beside, 1))
        noise = np.where(frames == places, np.float32(own) * each[2] + both, noise)
    return d, block, noise, _at_blocks(here.missing, block[2])


def _frames_of(block: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Places that paths have, from the blocks read for them: 2, 4 or 6."""
    near, far = (block[[2 - n, 2 + n]] >= 0 for n in (1, 2))
    return np.asarray(2 + 2 * near.all(axis=0) + 2 * far.all(axis=0), np.uint8)


def _at_blocks(field: Float, block: NDArray[np.int64]) -> Float:
    """A field (c, ny, nx) at flat indices of blocks, (c,) + their shape."""
    return np.asarray(np.take(field.reshape(len(field), -1), block, axis=1))


def _solved(seen: CameraDisplacements, parts: Float, record: LearnedRecord, unsteady: float = 0.0) -> Motion:
    """Least squares over the cameras."""
    rows = np.sqrt(seen.variance), np.sqrt(seen.noise_of_each)
    J, std, noise = np.moveaxis(seen.jacobian, (0, 1), (-2, -1)), *(np.moveaxis(row, 0, -1) for row in rows)

    def solve(moved: Float) -> tuple[Float, Float, Float]:
        return solve_displacement(J, np.moveaxis(moved, 0, -1), std, noise)

    d, eps, d_std = solve(seen.moved)
    chord = np.moveaxis(solve(seen.chord)[0], -1, 0)
    # what moves away from a camera at an even speed slows down in its image
    slowed = 0.25 * np.repeat(np.einsum("nc,cyx->nyx", seen.axes, chord), 2, axis=0) * seen.chord
    bend = np.moveaxis(solve(seen.bend + slowed)[0], -1, 0)
    trusted = seen.rejected == 0
    weight = np.isfinite(seen.moved[::2]).astype(np.float64)
    weight /= np.maximum(weight.sum(axis=0), 1.0)
    taken = 0.5 * (seen.missing[::2] + seen.missing[1::2])
    missing = (weight * taken / signal(seen, parts)).sum(axis=0)
    variance = np.moveaxis(np.square(d_std), -1, 0)
    variance += missing * parts[:, None, None]
    along, across = np.maximum(seen.camera_jitter()[1], record.camera_jitter)
    size = max(along, unsteady), across
    shaken = of_the_water(seen.jacobian, 1.0 / seen.variance, seen.determined, seen.line, size)
    variance += shaken[:, None, None]
    enough = trusted.sum(axis=0) >= 2
    why = np.bitwise_or.reduce(seen.rejected & ~np.uint16(Quality.OUTSIDE), axis=0)
    quality = np.where(enough, np.uint16(0), why | np.uint16(Quality.FILLED))
    quality |= np.where(seen.frames < 4, np.uint16(Quality.TWO_FRAME_MEAN), np.uint16(0))
    found = np.moveaxis(d, -1, 0), np.sqrt(variance), eps, misfit(seen, d), quality, seen.frames
    return Motion(*found, chord, bend)


def shares(settings: Settings, record: LearnedRecord) -> Float:
    """Relative variances of u, v, w by what the prior removes from waves: of water, or in a light sheet."""
    return np.asarray(_SHORT_WAVES if settings.sheet_thickness is None else np.square(record.moved))


def signal(seen: CameraDisplacements, parts: Float) -> Float:
    """Variance in each camera's image, mean of both components, of water that moves so.

    Returns (N, ny, nx): Px^2 for metres squared.
    """
    square = np.einsum("kiyx,i->kyx", np.square(seen.jacobian), parts)
    out: Float = 0.5 * (square[::2] + square[1::2])
    return out


def misfit(seen: CameraDisplacements, d: Float) -> Float:
    """Squared misfit of the cameras over what noise lets expect, per degree of freedom.

    With d (ny, nx, 3), metres; returns (ny, nx): chi^2 / (2N - 3).
    """
    left = np.einsum("rcyx,yxc->ryx", seen.jacobian, d) - seen.moved
    # one noise for all cameras: a quiet camera's own would make it contradict errors that are not noise
    square = np.square(left) / (seen.noise * seen.along[:, None, None])
    rows = np.isfinite(square).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(rows > 3, np.nansum(square, axis=0) / (rows - 3), np.nan)
