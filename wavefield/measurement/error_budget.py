"""Standard uncertainty of z, u, v, w: its square is the sum of five variances, one function each.

    std^2 = noise      noise of the images, propagated through the estimator (posterior variance); for
                       velocities times a factor if the cameras disagree by more (chi^2 > 1)
          + prior      waves that the prior suppresses (the rest of the posterior variance)
          + frames     waves that interpolation between frames does not follow
          + ripples    waves shorter than a block, which move single beads
          + setup      calibration error, height of the beads, thickness of a light sheet

Every term is an array (4, ny, nx), m^2: the variance of z, then of dx, dy, dz, the displacement per step. The
uncertainty of the level z = 0, common to all nodes and times, is not a part of it (`level_std`).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.kernels import BLOCK
from wavefield.matching.spectrum import Prior
from wavefield.measurement.displacement import FlowEstimate
from wavefield.measurement.geometry import WAVE_VARIANCES, GridGeometry
from wavefield.measurement.midtime import StepEstimate
from wavefield.measurement.model import LearnedRecord
from wavefield.measurement.paths import (
    EVEN_TIMES,
    FRAMES_OF_Z,
    elevation_gain,
    frame_weights,
    noise_of_displacements,
    path_gain,
)
from wavefield.measurement.velocity import MIN_NODES
from wavefield.rig.field import pixel_at
from wavefield.variables import EXACT_SIX, PATH_WEIGHTS, frames_of_path
from wavefield.water import dispersion

Float = NDArray[Any]

TERMS = "noise", "prior", "frames", "ripples", "setup"
# `changed_waves` compares z from six frames with z from four. The waves change if the difference is more than
# this factor above the expected one (1.0 to 1.1 on beads, to 1.5 on texture). The error of z is then this
# factor times the difference (1 to 4 in simulated seas that start within 0.25 s, at 20 frames/s).
CHANGE_FACTOR = 2.0
# mean squared cosine of the angle between two waves: 1/2 if all directions are equally frequent, 1 for one
CORRELATION_OF_DIRECTIONS = 0.75
HEIGHT_PER_WIDTH = 0.2  # height of beads on still water over their width: 0.17 to 0.20 in path-traced images
RELATIVE_HEIGHT_STD = 0.2  # relative uncertainty of a bead's visible height, which varies with light and view
RIPPLE_BLOCKS = 2.5  # blocks: the one wavelength that stands for all waves that blocks do not resolve
# Least fraction of the blocks' residual variance that two cameras share if there are ripples. It is 0.29 to
# 0.47 in simulated seas with ripples, and at most 0.13 without: in gaps, on short steep waves, path-traced.
MIN_SHARED = 0.2
# Fraction of the variance of ripples that two cameras share, 0.11 to 0.30 in simulated seas; the least is
# used. It is below 1 because the blocks of two cameras contain different beads.
SEEN_BY_BLOCKS = 0.11


class WaveRings(NamedTuple):
    """Variance of a record's waves by ring (bin of wavenumber), from its spectrum; fields are (rings,)."""

    k: Float  # rad/m
    variance: Float  # of z, m^2
    phase: Float  # per step, rad


def error_budget(
    estimate: StepEstimate,
    geometry: GridGeometry,
    record: LearnedRecord,
    frame_rate: float,
    times: Float,
) -> dict[str, Float]:
    """Return the variances (4, ny, nx), m^2, of z, dx, dy, dz (displacement per step), by name of the error.
    `times` (6,) of the six frames are in frame intervals from mid-time (half-way); `frame_rate` is in Hz."""
    waves = detected_waves(record.elevation, geometry.pixel, frame_rate)
    return {
        "noise": noise(estimate),
        "prior": removed_by_prior(estimate),
        "frames": removed_by_frames(estimate, waves, record.path_frames, times),
        "ripples": ripples(record.ripples, frame_rate)[:, None, None] + np.zeros_like(estimate.mid_time.z),
        "setup": stated_by_setup(estimate, geometry),
    }


def noise(estimate: StepEstimate) -> Float:
    """Return the noise part of the posterior variance of z, dx, dy, dz, (4, ny, nx), m^2.
    If N cameras disagree (chi^2 > 1), the last three are multiplied by (1 + (2N - 3) chi^2) / (2N - 2)."""
    motion, surfaces = estimate.motion, estimate.nearest
    z = np.mean([one.noise for one in surfaces], axis=0)
    chi2 = np.nan_to_num(motion.noise_factor, nan=1.0)
    return np.concatenate([z[None], motion.noise * chi2])


def removed_by_prior(estimate: StepEstimate) -> Float:
    """Return the variance of z, dx, dy, dz, (4, ny, nx), m^2, in waves that the prior suppresses."""
    z = np.mean([one.missing for one in estimate.nearest], axis=0)
    return np.concatenate([z[None], estimate.motion.missing])


def removed_by_frames(estimate: StepEstimate, waves: WaveRings, path_frames: int, times: Float) -> Float:
    """Return the variance of z, dx, dy, dz, (4, ny, nx), m^2, in waves lost by interpolation between frames.
    For z it is `lost_by_elevation` + `changed_waves`; for dx, dy, dz it is (`lost_by_paths` +
    `changed_waves`) times WAVE_VARIANCES. `path_frames` is the kind of path polynomial (`path_weights`);
    `times` (6,) are in frame intervals from mid-time."""
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
    """Return the variance of z, m^2, due to waves that start or stop within the six frames.
    Such waves make z from six frames differ from z from four frames. Without them, the variance of this
    difference would be noise sum (w6 - w4)^2 + sum S |K6 - K4|^2, with the weights w of the frames, the gains
    K and the variances S of the waves."""
    six, four = (frame_weights(times, FRAMES_OF_Z[n])[0] for n in (6, 4))
    apart = np.exp(1j * np.outer(waves.phase, times)) @ (six - four)
    expected = waves.variance @ np.square(np.abs(apart))
    expected += float(np.mean([one.noise.mean() for one in estimate.nearest])) * np.sum((six - four) ** 2)
    return CHANGE_FACTOR**2 * max(estimate.mid_time.departure - CHANGE_FACTOR**2 * float(expected), 0.0)


def lost_by_elevation(waves: WaveRings, frames: int, times: Float) -> float:
    """Return the variance of z, m^2, lost by interpolation in time from 6, 4, 3 or 2 frames (`frames`).
    It is sum S |1 - sum w_t exp(i p t)|^2: S variance, p phase per frame, w_t weight of the frame at time t.
    `times` are the times of six frames, in frame intervals from mid-time."""
    weights, _ = frame_weights(times, FRAMES_OF_Z[frames])
    seen = np.exp(1j * np.outer(waves.phase, times)) @ weights
    return float(waves.variance @ np.square(np.abs(1.0 - seen)))


def lost_by_paths(waves: WaveRings, path_frames: int, times: Float) -> float:
    """Return the variance of dz (displacement per step), m^2, lost by velocities from this kind of path.
    It is sum S |i p - sum w_t exp(i p t)|^2 plus `orbits`; symbols are as in `lost_by_elevation`, but w_t are
    weights of the time derivative. `path_frames` is explained in `path_weights`."""
    _, weights = frame_weights(times, FRAMES_OF_Z[frames_of_path(path_frames)], path_frames == 6)
    seen = np.exp(1j * np.outer(waves.phase, times)) @ weights
    return float(waves.variance @ np.square(np.abs(1j * waves.phase - seen))) + orbits(waves, path_frames)


def orbits(waves: WaveRings, path_frames: int) -> float:
    """Return the variance of the rise (change of z per step), m^2, lost because long waves carry short ones.

    A particle that long wave i displaces by xi has the velocity u + xi u' of short wave j. The phase of xi u'
    changes by p_i + p_j or p_i - p_j per frame. The loss is c sum S_i S_j (k_j p_j)^2 ((K(p_i - p_j) - K(p_j)
    + D)^2 + (K(p_j) - K(p_i + p_j) - D)^2), with the variance S, wavenumber k and phase per frame p of a
    wave; the gain K of velocities and Q of positions; D = 1 - Q(p_i); and c = 0.75, the mean squared cosine
    between the directions of two waves.
    """
    p, gain = waves.phase, path_gain(waves.phase, path_frames)
    of_sum, of_difference = (path_gain(p[:, None] + one, path_frames) for one in (p, -p))
    place = 1.0 - elevation_gain(p, min(path_frames, 4))[:, None]
    lost = np.square(of_difference - gain + place) + np.square(gain - of_sum - place)
    moved = waves.variance * np.square(waves.k * p)
    return float(CORRELATION_OF_DIRECTIONS * waves.variance @ lost @ moved)


def detected_waves(elevation: Prior, pixel: float, frame_rate: float) -> WaveRings:
    """Return the waves in the learned spectrum of z; rings (bins of k) below the noise have variance 0.
    `pixel` is the side of a rectified pixel, metres; `frame_rate` is in Hz."""
    k = np.array(elevation.k)
    detected = np.array(elevation.detected or [[True] * len(k)]).all(axis=0)
    power = elevation.wave_fraction * np.mean(elevation.power, axis=(0, 1)) * detected
    variance = power * k * np.gradient(k) / (2.0 * np.pi)
    k = k / (BLOCK * pixel)
    return WaveRings(k, variance, dispersion(k) / frame_rate)


def fast_waves(elevation: Prior, pixel: float, frame_rate: float) -> tuple[float, float]:
    """Return a tuple: the aliased fraction of the variance of dz/dt, and the longest aliased wavelength, m.
    A wave is aliased if its phase changes by more than pi per frame; both results are 0 without such waves.
    Arguments are as in `detected_waves`."""
    waves = detected_waves(elevation, pixel, frame_rate)
    rise = waves.variance * np.square(waves.phase)
    fast = (waves.phase > np.pi) & (rise > 0)
    if not fast.any():
        return 0.0, 0.0
    return float(rise[fast].sum() / rise.sum()), float(2.0 * np.pi / waves.k[fast][0])


def best_path_frames(waves: WaveRings, noise_variance: float) -> int:
    """Return the kind of path (4, 6 or 7, see `path_weights`) that gives velocities the smallest error.
    `noise_variance`, m^2, is the sum of the noise variances of dx, dy and dz."""

    def error(code: int) -> float:
        half = PATH_WEIGHTS[code]
        noise = noise_variance * noise_of_displacements(np.array([*half[:0:-1], *half])).sum()
        lost = float(WAVE_VARIANCES.sum()) * lost_by_paths(waves, code, EVEN_TIMES)
        return float(noise) + lost

    return min((4, 6, EXACT_SIX), key=error)


def ripples(learned: tuple[float, float], frame_rate: float) -> Float:
    """Return the variances (4,) of z, dx, dy, dz, m^2, due to waves shorter than blocks.
    `learned`: standard deviation of the change of z per step, and wavelength, m. With the variance a^2 of z
    and phase p per frame (at most pi/2), the change has 2 a^2 (1 - cos p), dz (w times interval) (a p)^2."""
    rise, wavelength = learned
    if not rise:
        return np.zeros(4, np.float32)
    phase = float(dispersion(np.array(2.0 * np.pi / wavelength))) / frame_rate
    z = rise**2 / (2.0 * (1.0 - np.cos(min(phase, 0.5 * np.pi))))
    return np.array([z, *(WAVE_VARIANCES * z * phase**2)], np.float32)


def stated_by_setup(estimate: StepEstimate, geometry: GridGeometry) -> Float:
    """Return the variance of z, dx, dy, dz, (4, ny, nx), m^2, due to calibration, light sheet and bead tilt.
    The error of z from the calibration is assumed to equal the smooth part of the epipolar error."""
    out = np.zeros((4, *estimate.mid_time.z.shape), np.float32)
    out[0] = np.mean([one.epipolar**2 for one in estimate.nearest])
    tilt = bead_tilt(estimate.mid_time.rise, geometry.grid.step, geometry.settings.bead_height)
    out[1:3] = np.square(RELATIVE_HEIGHT_STD * tilt)
    return out


def bead_tilt(rise: Float, step: float, height: float) -> Float:
    """Return how far tilting beads move relative to the water, -height grad(rise), (2, ny, nx), metres.
    `rise` (ny, nx) is the change of z per step, `step` the grid spacing, `height` that of beads; metres."""
    along_y, along_x = np.gradient(rise, step)
    return np.nan_to_num(-height * np.stack([along_x, along_y]))


def level_std(geometry: GridGeometry, record: LearnedRecord | None) -> float:
    """Return the standard uncertainty, m, of the height of z = 0, equal for all nodes; NaN if unknown."""
    levelled = geometry.rig.provenance.get("levelled")
    if geometry.z_is_known:
        return 0.0  # `stated_by_setup` contains it
    for name in ("camera_height_std_m", "rms_m"):
        if isinstance(levelled, Mapping) and name in levelled:
            return float(levelled[name])
    if geometry.settings.bead_height:
        return geometry.settings.bead_height
    if record is None:
        return float("nan")
    x, y = float(np.mean(geometry.grid.x)), float(np.mean(geometry.grid.y))
    widths = [width * pixel_at(geometry.rig[name], x, y) for name, width in record.beads]
    # z is too high by the height of the beads, unless the rig was levelled on still water with such beads
    return HEIGHT_PER_WIDTH * min(widths)


# Ripples shorter than a block move single beads, and all cameras see this. The covariance between the
# residual displacements of two cameras therefore gives the height of the ripples, once for a record.


def shared_motion(found: Mapping[str, FlowEstimate], z: Float, geometry: GridGeometry) -> tuple[float, float]:
    """Return a tuple of two estimates of the variance of ripples' dz (displacement per frame), m^2.

    Ripples whose dz has the variance c displace blocks of cameras a and b with the covariance J_a diag(1/2,
    1/2, 1) J_b^T c; J are the Jacobians on the surface z (ny, nx), metres. The first estimate fits c to the
    products of the scores (gradient times residual) of two cameras, the second to the squared scores of each
    camera (geometric mean). Scores are first divided by the square root of their Hessian's trace, so that all
    have equal noise. The result is from the pair with the smallest ratio first / second, because neighbouring
    cameras also share changes of light. `found` are the displacements by camera.
    """
    scores, waves = {}, {}
    for name, one in found.items():
        sight = geometry.sights[name]
        x, y, *jacobian = sight.at(z).reshape(8, -1)
        ny, nx = sight.lattice.shape
        rows = np.rint((y - sight.lattice.y0) / sight.lattice.step)
        columns = np.rint((x - sight.lattice.x0) / sight.lattice.step)
        inside = (rows >= 0) & (rows < ny) & (columns >= 0) & (columns < nx)
        rows, columns = rows.clip(0, ny - 1).astype(np.intp), columns.clip(0, nx - 1).astype(np.intp)
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
    """Return the standard deviation of ripples' dz per frame, m; 0 if ripples are not significant.
    `shared` and `total` are the first and second result of `shared_motion`."""
    return float(np.sqrt(shared / SEEN_BY_BLOCKS)) if shared > MIN_SHARED * total else 0.0


def covariance(A: Float, B: Float) -> Float:
    """Return the covariance (2, 2, n) of the scores of two cameras due to ripples with unit variance of dz.
    A and B (2, 3, n) are the derivatives of each camera's scores with respect to the motion of the water."""
    return np.asarray(np.einsum("ikn,k,jkn->ijn", A, WAVE_VARIANCES, B))
