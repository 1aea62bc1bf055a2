"""The standard uncertainty of z, u, v, w: the sum of the variances that this file computes.

    std^2 = chi^2 (noise through the estimator)          posterior variance, by the information near a node;
                                                         chi^2 is 1 for z
          + (spectrum that the prior removes)            posterior variance as well
          + (spectrum that the weights of frames remove)
          + (ripples shorter than a block)
          + (what the set-up states: epipolar error, height of beads, thickness of a light sheet)

Every term is an array (4, ny, nx): variances of z, m^2, and of the displacement per step dx, dy, dz, m^2. The
uncertainty of z = 0, common to all nodes and times, is kept apart (`level_std`).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavefield.matching import Prior
from wavefield.matching.kernels import BLOCK
from wavefield.measurement.displacement import FlowEstimate
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.midtime import StepEstimate
from wavefield.measurement.model import LearnedRecord
from wavefield.measurement.outliers import MIN_NODES
from wavefield.measurement.paths import (
    EVEN_TIMES,
    FRAMES_OF_Z,
    elevation_gain,
    frame_weights,
    noise_of_displacements,
    path_gain,
)
from wavefield.measurement.regrid import BlockLattice
from wavefield.measurement.velocity import WAVE_VARIANCES
from wavefield.rig.field import pixel_at
from wavefield.variables import EXACT_SIX, PATH_WEIGHTS, frames_of_path
from wavefield.water import dispersion

Float = NDArray[Any]

TERMS = "noise", "prior", "frames", "ripples", "setup"
CHANGE_RATIO = 2.0  # error of z over its departure where waves start within 0.25 s at 20 frames/s: 1 to 4
CHANGE_DETECTED = 2.0  # departure over that expected: 1.0 to 1.1 on beads, to 1.5 on texture; more is change
CORRELATION_OF_DIRECTIONS = 0.75  # of two waves: 1/2 in all directions, 1 in one
HEIGHT_PER_WIDTH = 0.2  # of beads on still water, by their width in the images: 0.17 to 0.20 when path-traced
RELATIVE_HEIGHT_STD = 0.2  # of the visible part of a bead, which changes with light and view
RIPPLE_BLOCKS = 2.5  # wavelength that stands for all waves that blocks do not resolve
# Part of the blocks' residual variance that two cameras share: 0.29 to 0.47 in seas with ripples, at most
# 0.13 in gaps, on short steep waves and of other renderers
MIN_SHARED = 0.2
SEEN_BY_BLOCKS = 0.11  # of the ripples' variance, the least of 0.11 to 0.30: blocks hold different beads


class WaveRings(NamedTuple):
    """Detected waves of a record in rings of wavenumber; fields are (rings,)."""

    k: Float  # rad/m
    variance: Float  # of z, m^2
    phase: Float  # per step, rad


def error_budget(
    estimate: StepEstimate,
    geometry: GridGeometry,
    record: LearnedRecord,
    frame_rate: float,
    times: Float = EVEN_TIMES,
) -> dict[str, Float]:
    """Variances of z and dx, dy, dz of one step by term, each (4, ny, nx), m^2."""
    waves = detected_waves(record.elevation, geometry.pixel, frame_rate)
    return {
        "noise": noise(estimate),
        "prior": removed_by_prior(estimate),
        "frames": removed_by_frames(estimate, waves, record.path_frames, times),
        "ripples": ripples(record.ripples, frame_rate)[:, None, None] + np.zeros_like(estimate.mid_time.z),
        "setup": stated_by_setup(estimate, geometry),
    }


def noise(estimate: StepEstimate) -> Float:
    """Noise of the blocks, sum of F^2 A / (F^2 A + 1/S)^2 over the modes, propagated through the paths.

    Where displacements of the cameras disagree by more than this (chi^2 > 1) that of velocities is multiplied
    by (1 + (2N - 3) chi^2) / (2N - 2).
    """
    motion, surfaces = estimate.motion, estimate.nearest
    z = np.mean([one.noise for one in surfaces], axis=0)
    chi2 = np.nan_to_num(motion.noise_factor, nan=1.0)
    return np.concatenate([z[None], motion.noise * chi2])


def removed_by_prior(estimate: StepEstimate) -> Float:
    """Waves that the prior removes: sum of 1/S / (F^2 A + 1/S)^2 over the modes, for the part of S that is
    waves.

    All cameras miss the same waves, so averaging over cameras does not reduce it. It is divided among u, v, w
    in the proportions of wave motion.
    """
    z = np.mean([one.missing for one in estimate.nearest], axis=0)
    return np.concatenate([z[None], estimate.motion.missing])


def removed_by_frames(estimate: StepEstimate, waves: WaveRings, path_frames: int, times: Float) -> Float:
    """Waves that turn too fast for the frame rate: sum S |1 - K(omega dt)|^2, times (omega dt)^2 for
    velocities.

    z comes from 6, 4, 3 or 2 frames, velocities from paths through 6, 4 or 2.
    """
    out = np.zeros((4, *estimate.mid_time.z.shape), np.float32)
    for count in np.unique(estimate.mid_time.frames).tolist():
        out[0][estimate.mid_time.frames == count] = lost_by_elevation(waves, count, times)
    for count in np.unique(estimate.motion.frames).tolist():
        code = max(path_frames, count) if count == 6 else count
        lost = lost_by_paths(waves, code, times) * WAVE_VARIANCES.astype(np.float32)
        out[1:] += np.where(estimate.motion.frames == count, lost[:, None, None], np.float32(0))
    change = changed_waves(estimate, waves, times)
    return out + np.array([change, *(change * WAVE_VARIANCES)], np.float32)[:, None, None]


def changed_waves(estimate: StepEstimate, waves: WaveRings, times: Float) -> float:
    """Variance of z, m^2, from waves that start or stop within the six frames.

    They show as a difference between z from six and from four frames. Noise and stationary waves explain
    noise sum (w6 - w4)^2 + sum S |K6 - K4|^2 of its square; beyond four times that, four times the excess is
    added.
    """
    six, four = (frame_weights(times, FRAMES_OF_Z[n])[0] for n in (6, 4))
    apart = np.exp(1j * np.outer(waves.phase, times)) @ (six - four)
    expected = waves.variance @ np.square(np.abs(apart))
    expected += float(np.mean([one.noise.mean() for one in estimate.nearest])) * np.sum((six - four) ** 2)
    return CHANGE_RATIO**2 * max(estimate.mid_time.departure - CHANGE_DETECTED**2 * float(expected), 0.0)


def lost_by_elevation(waves: WaveRings, frames: int, times: Float = EVEN_TIMES) -> float:
    """Variance of z, m^2, lost by interpolation with weights w at times t: sum S |1 - sum w e^(ipt)|^2."""
    weights, _ = frame_weights(times, FRAMES_OF_Z[frames])
    seen = np.exp(1j * np.outer(waves.phase, times)) @ weights
    return float(waves.variance @ np.square(np.abs(1.0 - seen)))


def lost_by_paths(waves: WaveRings, path_frames: int, times: Float = EVEN_TIMES) -> float:
    """Variance of the rise per step, m^2, that paths through the frames miss, plus that of `orbits`.
    The sum over waves of S |i p - sum_t w_t exp(i p t)|^2, with S the variance of a wave, p its phase per
    frame, w_t the weight of the frame at time t (in frames).
    """
    _, weights = frame_weights(times, FRAMES_OF_Z[frames_of_path(path_frames)], path_frames == 6)
    seen = np.exp(1j * np.outer(waves.phase, times)) @ weights
    return float(waves.variance @ np.square(np.abs(1j * waves.phase - seen))) + orbits(waves, path_frames)


def orbits(waves: WaveRings, path_frames: int) -> float:
    """Variance of the rise per step, m^2, that paths lose where the orbits of waves i carry short waves j.

    A particle displaced by xi meets u + xi u', which turns with the sum or difference of both phases p; the
    frames miss a part D = 1 - Q(p_i) of xi. With K the gain of paths and Q that of places: c sum S_i S_j (k_j
    p_j)^2 ((K(p_i - p_j) - K(p_j) + D)^2 + (K(p_j) - K(p_i + p_j) - D)^2).
    """
    p, gain = waves.phase, path_gain(waves.phase, path_frames)
    of_sum, of_difference = (path_gain(p[:, None] + one, path_frames) for one in (p, -p))
    place = 1.0 - elevation_gain(p, min(path_frames, 4))[:, None]
    lost = np.square(of_difference - gain + place) + np.square(gain - of_sum - place)
    moved = waves.variance * np.square(waves.k * p)
    return float(CORRELATION_OF_DIRECTIONS * waves.variance @ lost @ moved)


def detected_waves(elevation: Prior, pixel: float, frame_rate: float) -> WaveRings:
    """Waves of the learned spectrum of z that exceed the noise: variance S k dk / (2 pi) of each ring."""
    k = np.array(elevation.k)
    detected = np.array(elevation.detected or [[True] * len(k)]).all(axis=0)
    power = elevation.wave_fraction * np.mean(elevation.power, axis=(0, 1)) * detected
    variance = power * k * np.gradient(k) / (2.0 * np.pi)
    k = k / (BLOCK * pixel)
    return WaveRings(k, variance, dispersion(k) / frame_rate)


def fast_waves(elevation: Prior, pixel: float, frame_rate: float) -> tuple[float, float]:
    """Fraction of the variance of the rise that is aliased, and the longest aliased wave, metres.
    A wave is aliased if it turns by more than half a turn from frame to frame.
    """
    waves = detected_waves(elevation, pixel, frame_rate)
    rise = waves.variance * np.square(waves.phase)
    fast = (waves.phase > np.pi) & (rise > 0)
    if not fast.any():
        return 0.0, 0.0
    return float(rise[fast].sum() / rise.sum()), float(2.0 * np.pi / waves.k[fast][0])


def best_path_frames(waves: WaveRings, noise_variance: float) -> int:
    """The `path_frames` with the smallest error, for the noise variance of dx, dy, dz together, m^2."""

    def error(code: int) -> float:
        half = PATH_WEIGHTS[code]
        noise = noise_variance * noise_of_displacements(np.array([*half[:0:-1], *half])).sum()
        lost = float(WAVE_VARIANCES.sum()) * lost_by_paths(waves, code)
        return float(noise) + lost

    return min((4, 6, EXACT_SIX), key=error)


def ripples(learned: tuple[float, float], frame_rate: float) -> Float:
    """Variances (4,) of waves shorter than blocks, from the std of their rise per frame and a wavelength.

    Waves of variance a^2 and phase p per frame rise by a variance of 2 a^2 (1 - cos p) per frame, or 2 a^2
    where they turn by more than a quarter, at a rate of variance (a p)^2.
    """
    rise, wavelength = learned
    if not rise:
        return np.zeros(4, np.float32)
    phase = float(dispersion(np.array(2.0 * np.pi / wavelength))) / frame_rate
    z = rise**2 / (2.0 * (1.0 - np.cos(min(phase, 0.5 * np.pi))))
    return np.array([z, *(WAVE_VARIANCES * z * phase**2)], np.float32)


def stated_by_setup(estimate: StepEstimate, geometry: GridGeometry) -> Float:
    """Calibration error of z, thickness of a light sheet, and uncertainty of the tilt of beads.

    The calibration error along the sight lines is taken to equal the smooth error across them.
    """
    out = np.zeros((4, *estimate.mid_time.z.shape), np.float32)
    out[0] = np.mean([one.epipolar**2 for one in estimate.nearest])
    if geometry.settings.sheet_thickness is not None:  # its light is as wide as four standard deviations
        out[0] = (0.25 * geometry.settings.sheet_thickness) ** 2
    tilt = bead_tilt(estimate.mid_time.rise, geometry.grid.step, geometry.settings.bead_height)
    out[1:3] = np.square(RELATIVE_HEIGHT_STD * tilt)
    return out


def bead_tilt(rise: Float, step: float, height: float) -> Float:
    """Additional motion of tall beads per step along x and y, (2, ny, nx), from the rise (ny, nx), metres.
    A point at height h along the normal moves by -h d(grad z)/dt more than the water.
    """
    along_y, along_x = np.gradient(rise, step)
    return np.nan_to_num(-height * np.stack([along_x, along_y]))


def level_std(geometry: GridGeometry, record: LearnedRecord | None) -> float:
    """Standard uncertainty of z = 0, metres, common to all nodes and times; NaN without a learned record."""
    levelled = geometry.rig.provenance.get("levelled")
    if geometry.settings.sheet_thickness is not None:
        return 0.0  # that of z contains it
    if isinstance(levelled, Mapping) and "camera_height_std_m" in levelled:
        return float(levelled["camera_height_std_m"])
    if isinstance(levelled, Mapping) and "rms_m" in levelled:
        return float(levelled["rms_m"])
    if geometry.settings.bead_height:
        return geometry.settings.bead_height
    if record is None:
        return float("nan")
    x, y = float(np.mean(geometry.grid.x)), float(np.mean(geometry.grid.y))
    widths = [width * pixel_at(geometry.rig[name], x, y) for name, width in record.beads]
    # z is too high by the height of the beads unless the rig was levelled on still water, which includes it
    return HEIGHT_PER_WIDTH * min(widths)


# Ripples shorter than a block move single beads, in all cameras alike: what the residual displacements of
# blocks of two cameras share gives their height, once for a record.


def shared_motion(found: Mapping[str, FlowEstimate], z: Float, geometry: GridGeometry) -> tuple[float, float]:
    """Variance of the rise per frame, m^2, that the blocks of two cameras share, and that of single blocks.

    Ripples whose rise has the variance c move the blocks of cameras a and b by displacements of covariance
    J_a diag(1/2, 1/2, 1) J_b^T c, on the surface z (ny, nx). Both variances are fitted to the blocks' scores,
    each over the square root of its Hessian's trace, so that all have the same noise. Of several pairs of
    cameras the one counts that shares least: cameras side by side share changes of light as well. The shared
    variance may be negative by chance; both are 0 if no two cameras measured enough blocks.
    """
    scores, waves = {}, {}
    for name, one in found.items():
        sight = geometry.sights[name]
        x, y, *jacobian = sight.at(z).reshape(8, -1)
        columns, rows, inside = blocks_at(sight.lattice, x, y)
        xx, xy, yy = one.found.hessian[:, rows, columns]
        scale = 1.0 / np.sqrt(np.maximum(xx + yy, 1e-30), dtype=np.float64)
        usable = inside & one.found.valid[rows, columns] & (xx + yy > 0)
        scores[name] = np.where(usable, one.found.score[:, rows, columns] * scale, np.nan)
        J = np.reshape(jacobian, (2, 3, -1))
        waves[name] = np.stack([xx * J[0] + xy * J[1], xy * J[0] + yy * J[1]]) * scale
    pairs = []
    for a, b in combinations(scores, 2):
        both = np.isfinite(scores[a][0]) & np.isfinite(scores[b][0])
        if both.sum() < MIN_NODES:
            continue
        p, q, A, B = (parts[n][..., both] for parts in (scores, waves) for n in (a, b))
        expected = covariance(A, B)
        shared = np.sum(expected * (p[:, None] * q)) / np.sum(np.square(expected))
        own = [np.sum(np.square(r)) / np.einsum("iin->", covariance(M, M)) for r, M in ((p, A), (q, B))]
        pairs.append((float(shared), float(np.sqrt(own[0] * own[1]))))
    return min(pairs, default=(0.0, 0.0), key=lambda pair: pair[0] / max(pair[1], 1e-30))


def ripple_rise(shared: float, total: float) -> float:
    """Standard deviation of the rise of ripples per frame, metres; 0 without. Arguments: `shared_motion`."""
    return float(np.sqrt(shared / SEEN_BY_BLOCKS)) if shared > MIN_SHARED * total else 0.0


def blocks_at(
    lattice: BlockLattice, x: Float, y: Float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Column and row of the blocks nearest to places x, y (n,), px, and whether places are on the lattice."""
    ny, nx = lattice.shape
    column, row = (np.rint((v - v0) / lattice.step) for v, v0 in ((x, lattice.x0), (y, lattice.y0)))
    inside = (column >= 0) & (column < nx) & (row >= 0) & (row < ny)
    return column.clip(0, nx - 1).astype(np.intp), row.clip(0, ny - 1).astype(np.intp), inside


def covariance(A: Float, B: Float) -> Float:
    """Covariance (2, 2, n) of two scores, for waves with unit variance of the rise.
    A and B (2, 3, n) are the derivatives of the scores with respect to the motion of the water.
    """
    return np.asarray(np.einsum("ikn,k,jkn->ijn", A, WAVE_VARIANCES, B))
