"""Error of a finite time step: what the frames leave out of waves whose phase turns fast."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavefield.matching import Prior
from wavefield.matching.matching_kernels import BLOCK
from wavefield.measurement.time_weights import elevation_gain, noise_weights, path_gain, place_weights
from wavefield.variables import EXACT_SIX
from wavefield.water import dispersion

Float = NDArray[Any]
Mask = NDArray[np.bool_]
Parts = tuple[float, float, float, float]

_DETECTED_SNR = 6.0  # of the power of a ring whose waves are used
_LEAKAGE = 0.5  # of a ring's power through a Hann window, over the distance in rings to the power of 6
_MAIN_LOBE_RINGS = 3  # nearer rings are mixed by the window
_DIRECTIONS = 16  # of waves, relative to the motion of the water
_MIN_NODES = 6  # along either side of a field
_LINES_PER_WAVE = 4.5  # lines of a windowed transform that are not independent
_MIN_PHASE = 1e-3  # of slower waves nothing is left out
_MAX_PHASE = 1.5 * np.pi  # beyond that waves are not followed at all
_WEAK_POWER = 0.01  # of the strongest ring's: phases of weaker rings are of errors rather than of waves
_HALF_TRUSTED_WAVES = 20.0  # in a ring: its own phase then counts by half
_MIN_WAVES_OF_SMOOTH_PATHS = 100.0  # give phases to a tenth, and to half of it what smooth paths leave out
_TRUNCATION_MARGIN = 1.5  # on the error of waves along a path
_LEVEL_WAVELENGTH = 1.5  # fields: the mean over the field has a sixth of the variance of such waves, or less
_MEAN_OF_DIRECTIONS = 0.75  # of what orbits make of velocities: 1/2 in all directions, 1 in one
_CHORD_FACTOR = 1.1  # a chord is not on the path either, the less so the steeper the waves


@dataclass(frozen=True)
class TemporalTruncation:
    """Standard deviation over the field of what the finite time step leaves out; pairs are hashable."""

    z: tuple[tuple[int, float], ...]  # of z at mid-time by number of frames (2, 3, 4, 6), metres
    # Of the displacement per step by `path_frames` (2, 4, 7 and, with enough waves, 6), over the rms of its
    # rise: along either axis in water without mean motion, and in addition where it moves as far as on
    # average (squares add); then the same of its rise.
    d: tuple[tuple[int, Parts], ...]
    rise: float = 0.0  # rms rise of the sample steps, metres

    def of_z(self, frames: int) -> float:
        """Of z at mid-time from so many frames, metres."""
        return dict(self.z)[frames]

    def of_displacement(self, frames: int, d: Float, measured: NDArray[np.bool_]) -> Float:
        """Of displacements per step by `path_frames`, (3, ny, nx), metres, as d.
        Half of the error along the axes is shared as the motion, half evenly: short waves spread more.
        """
        still, moving, still_up, moving_up = np.square(dict(self.d)[frames])
        if not measured.any():
            return np.zeros_like(d)
        x, y = (float(np.var(part[measured])) for part in d[:2])
        share = 0.5 + 0.5 * np.array([x, y]) * 2.0 / max(x + y, 1e-30)
        speed = np.square(d[0]) + np.square(d[1])
        speed /= max(float(np.mean(speed[measured])), 1e-30)
        up = still_up + moving_up * speed
        along = still + moving * speed
        # when waves longer than the field have their crest in it, no water rises, but all paths bend
        rise = np.float32(max(np.sqrt(np.mean(np.square(d[2][measured]))), self.rise))
        return np.asarray(rise * np.sqrt(np.stack([share[0] * along, share[1] * along, up])))

    def total(self, frames: int) -> float:
        """Variance of the displacement per step by `path_frames`, over that of the rise."""
        still, moving, still_up, moving_up = np.square(dict(self.d)[frames])
        return float(2.0 * (still + moving) + still_up + moving_up)

    def best_frames(self, rise: float, noise_variance: float) -> int:
        """The `path_frames` with the smallest error, for the rms rise and the noise of displacements.
        Smooth paths of six where many waves determine the phase, and by more than its uncertainty.
        """

        def error(frames: int) -> float:
            own, *neighbours = noise_weights(frames)
            lost = _TRUNCATION_MARGIN**2 * (rise**2 * self.total(frames))
            return noise_variance * (own + 2.0 * sum(neighbours)) + lost

        return min((kind for kind, _ in self.d if kind > 2), key=error)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a recipe."""
        z, d = {str(n): value for n, value in self.z}, {str(n): list(parts) for n, parts in self.d}
        return {"z": z, "d": d, "rise": self.rise}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TemporalTruncation:
        """Inverse of `to_dict`."""
        z = tuple((int(n), float(value)) for n, value in data["z"].items())
        d = tuple((int(n), _parts(value)) for n, value in data["d"].items())
        return cls(z, d, float(data.get("rise", 0.0)))


def detected_waves(
    elevation: Prior, pixel: float, step: float, frame_rate: float, k: Float
) -> tuple[Float, Float, Float]:
    """Waves at k, rad per node: 1 where the elevation shows them, the power of their cosines on nodes where
    only several cameras in common do, m^2, and their phase per step. The pixel and the step are in metres.
    """
    block = BLOCK * pixel
    shown, common = detected_rings(elevation)
    power = np.mean(elevation.power, axis=(0, 1)) * common * np.square(block / step)
    of_rings = (np.interp(k * block / step, elevation.k, one) for one in (shown, power))
    return *of_rings, dispersion(k / step) / frame_rate


def fast_waves(elevation: Prior, pixel: float, frame_rate: float) -> tuple[float, float]:
    """Share of the variance of the rise by detected waves that turn by more than half a turn from frame to
    frame, which frames do not follow, and the longest of them, metres. The pixel of z is in metres.
    """
    k, block = np.array(elevation.k), BLOCK * pixel
    phase = dispersion(k / block) / frame_rate
    rise = np.mean(elevation.power, axis=(0, 1)) * k * np.square(phase) * detected_rings(elevation)[0]
    fast = (phase > np.pi) & (rise > 0)
    if not fast.any():
        return 0.0, 0.0
    return float(rise[fast].sum() / rise.sum()), float(2.0 * np.pi * block / k[fast][0])


def detected_rings(elevation: Prior) -> tuple[Float, Float]:
    """Rings in which the elevation shows waves, and what part of the power several cameras have in common."""
    shown = np.array(elevation.shown or [[0.0]]).min(axis=0) >= 1.0
    common = np.array(elevation.in_common or [[0.0]]).min(axis=0)
    every = np.ones(len(elevation.k))
    return shown * every, common * every


def _parts(values: Sequence[float]) -> Parts:
    still, moving, still_up, moving_up = map(float, values)
    return still, moving, still_up, moving_up


NOTHING = TemporalTruncation(
    tuple((n, 0.0) for n in (2, 3, 4, 6)), tuple((n, (0.0, 0.0, 0.0, 0.0)) for n in (2, 4, EXACT_SIX))
)


def temporal_truncation(
    pairs: Sequence[tuple[Float, Float]],
    step: float,
    noise: Callable[[Float], Float] | None = None,
    matching_gain: Callable[[Float], Float] | None = None,
    detected: Callable[[Float], tuple[Float, Float, Float]] | None = None,
) -> TemporalTruncation:
    """Error of the finite time step, metres, from elevations at two consecutive frames (ny, nx).
    Noise variance, the gain G of matching and `detected_waves`, whose phase counts where that of these
    elevations does not show, are functions of wavenumber, rad per node; step is in metres.
    """
    if not pairs or min(pairs[0][0].shape) < _MIN_NODES:
        return NOTHING
    # in each ring the power of the difference over that of the sum is tan^2(p/2), p = omega dt; P is both
    # over four
    k, power, phase, known, waves = _wave_rings(pairs, step, noise, detected)
    # z leaves out sum P (1 - K)^2 (`elevation_gain`), three frames p^3/16
    z = {n: float(np.sqrt(np.sum(power * (1.0 - elevation_gain(phase, n)) ** 2))) for n in (2, 4, 6)}
    z[3] = float(np.sqrt(np.sum(power * np.minimum(phase**3 / 16.0, 1.0) ** 2)))
    gain = np.ones_like(k) if matching_gain is None else matching_gain(k * step)
    rise = float(np.mean([np.mean(np.square(b - a)) for a, b in pairs]))
    if detected is not None:  # elevations have less of these waves
        rise = max(rise, float(np.sum(power * np.square(2.0 * np.sin(0.5 * phase)))))
    d = []
    factors = {2: _CHORD_FACTOR, 4: 1.0, EXACT_SIX: 1.0}
    if waves > _MIN_WAVES_OF_SMOOTH_PATHS:
        factors[6] = 1.0
    for n, factor in factors.items():
        still, moving = (_left_out_of_paths(power, phase, k, far, gain, n) for far in (0.0, np.sqrt(rise)))
        still[0] += 0.5 * _of_pairs(power * known, phase, k, n)
        added = np.maximum(moving - still, 0.0)
        across, up = factor * np.sqrt(np.stack([still, added], axis=1) / max(rise, 1e-30))
        d.append((n, (float(across[0]), float(across[1]), float(up[0]), float(up[1]))))
    return TemporalTruncation(tuple(sorted(z.items())), tuple(d), float(np.sqrt(rise)))


def _wave_rings(
    pairs: Sequence[tuple[Float, Float]],
    step: float,
    noise: Callable[[Float], Float] | None,
    detected: Callable[[Float], tuple[Float, Float, Float]] | None,
) -> tuple[Float, Float, Float, Mask, float]:
    """Wavenumber, rad/m, power, m^2, and phase per step of the waves in rings; of which rings they are known;
    number of all waves.
    """
    shape = pairs[0][0].shape
    inner = shape[0] - 2, shape[1] - 2
    ring, k, square = _rings(inner)
    count = np.bincount(ring)
    noise_power = np.zeros(count.size)
    if noise is not None:  # there is more of it in every wave of a smaller field
        noise_power = 2.0 * np.bincount(ring, noise(k)) * np.prod(shape) / np.prod(inner)

    def ring_power(filtered: Callable[[Float], Float], sign: float, weight: Float) -> Float:
        powers = [np.bincount(ring, weight * _power(filtered(a + sign * b))) for a, b in pairs]
        return np.asarray(np.maximum(np.mean(powers, axis=0) - noise_power, 0.0))

    # of the curvature: waves as long as the field would fill the first rings with their own slow phase
    curved = [ring_power(_curvature, sign, 1.0 / square) for sign in (1.0, -1.0)]
    total = [ring_power(_inner, sign, np.ones_like(k)) for sign in (1.0, -1.0)]
    plus, minus = np.minimum(curved, total)
    own_phase = _phase(*curved)
    power = 0.25 * (plus + minus)
    curvature = 0.25 * np.sum(curved, axis=0) * np.bincount(ring, square) / count
    significant = (power > 0.25 * _DETECTED_SNR * noise_power) & (
        curvature > _DETECTED_SNR * _leaked(curvature)
    )
    significant[0] = False
    followed = significant & (own_phase > 0)
    peak = 1 + int(np.argmax(power[1:]))  # beyond it, after a ring without waves phases are of noise
    followed[peak:] = np.logical_and.accumulate(followed[peak:])
    waves, known = np.where(followed, count * len(pairs) / _LINES_PER_WAVE, 0.0), followed
    hidden = [np.bincount(ring, part) for part in detected(k)] if detected is not None else None
    k = np.bincount(ring, k) / count / step
    strong = power / (power + _WEAK_POWER * np.max(power * followed, initial=1e-30))
    phase = _shrunk_phases(own_phase, waves, waves * strong, dispersion(k))
    # rounding makes less than nothing of a difference in which no wave is left
    longer = np.maximum(np.sum(total, axis=1) - [plus[1:].sum(), minus[1:].sum()], 0.0)
    power[0], phase[0] = 0.25 * longer.sum(), _phase(*longer)
    slowest = float(phase[:2].max()) / np.sqrt(_LEVEL_WAVELENGTH)  # by the relation of deep water
    rise = float(np.mean([np.square(np.mean(b - a)) for a, b in pairs]))
    level = rise / max(4.0 * np.sin(0.5 * slowest) ** 2, _MIN_PHASE**2)
    if hidden is not None:
        shown, variance, turned = hidden[0] / count, hidden[1] / np.prod(inner), hidden[2] / count
        alone = ~followed & significant & (shown > 0.5)
        common = ~followed & (variance > power) & (np.arange(count.size) > 0)
        power, phase = np.where(common, variance, power), np.where(alone | common, turned, phase)
        known = followed | alone | common
    k, power, phase = (np.append(part, one) for part, one in zip((k, power, phase), (0.0, level, slowest)))
    return k, power, phase, np.append(known, True), float(waves.sum())


def _left_out_of_paths(power: Float, phase: Float, k: Float, far: float, gain: Float, frames: int) -> Float:
    """Variance that paths leave out along either axis and of the rise, (2,), where water moves so far."""
    theta = np.pi * (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    moved = far * k * np.cos(theta)[:, None]
    # a wave along theta has phase q = p - k d cos(theta) where the water moves by d; matching leaves G, the
    # path K(q)
    q = phase - moved
    # what the prior removes of displacements, (1 - G)^2, is stated separately
    removed = np.square((1.0 - gain) * np.sinc(q / (2.0 * np.pi)))
    lost = np.square(1.0 - gain * path_gain(q, frames)) - removed
    along = 0.5 * np.sum(power * phase**2 * np.maximum(lost, 0.0))
    rise = _rise_error(power, phase, k, moved, gain, frames) - removed * q**2
    return np.array([along, np.sum(power * np.maximum(rise, 0.0))]) / _DIRECTIONS


def _of_pairs(power: Float, phase: Float, k: Float, frames: int) -> float:
    """Variance that paths leave out of what the orbits of waves i make of the velocity of waves j.
    A particle that is moved by xi meets u + xi u', whose phase is the sum or the difference of both, and
    frames leave out a part of xi from its place. With the gains K of paths and Q of places, D = 1 - Q(p_i):
    c sum P_i P_j (k_j p_j)^2 ((K(p_i - p_j) - K(p_j) + D)^2 + (K(p_j) - K(p_i + p_j) - D)^2), with c from 1/2
    for waves in all directions to 1 for those in one.
    """
    gain = path_gain(phase, frames)
    of_sum, of_difference = (path_gain(phase[:, None] + one, frames) for one in (phase, -phase))
    place = 1.0 - elevation_gain(phase, min(frames, 4))[:, None]
    lost = np.square(of_difference - gain + place) + np.square(gain - of_sum - place)
    return float(_MEAN_OF_DIRECTIONS * power @ lost @ (power * np.square(k * phase)))


def _rise_error(power: Float, phase: Float, k: Float, moved: Float, gain: Float, frames: int) -> Float:
    """Squared error of the rise along a path, over the power of each wave, (directions, rings).
    The path is a Gaussian process with given motion per step at mid-time; the rest of it turns the wave too.
    """
    t, weights = place_weights(frames)
    apart, each = np.subtract.outer(t, t)[..., None], np.multiply.outer(t, phase)
    still = 1.0 - np.cos(each)
    # covariances of the places, from mid-time on, and with the motion there; along one axis
    places = 0.5 * ((np.cos(apart * phase) - 1.0 + still[:, None] + still[None]) @ power)
    with_motion, motion = 0.5 * (phase * np.sin(each)) @ power, 0.5 * np.sum(power * phase**2)
    rho = with_motion / max(motion, 1e-30)
    rest = places - np.outer(with_motion, rho)
    own = np.diag(rest)
    between = own[:, None] + own - 2.0 * rest
    seen = gain * weights[:, None] * np.exp(1j * (each - moved[:, None] * rho[:, None]))
    exact = phase - moved
    mean = np.sum(seen * np.exp(-0.5 * np.multiply.outer(own, k**2)), axis=1)
    pairs = np.real(seen[:, :, None] * seen[:, None].conj()) * np.exp(-0.5 * np.multiply.outer(between, k**2))
    return np.asarray(np.square(exact) - 2.0 * exact * np.imag(mean) + pairs.sum(axis=(1, 2)))


def _leaked(power: Float) -> Float:
    """Power that the window brings into every ring from those that are not next to it."""
    apart = np.abs(np.subtract.outer(np.arange(power.size), np.arange(power.size)))
    reach = np.where(apart >= _MAIN_LOBE_RINGS, _LEAKAGE / np.maximum(apart, 1.0) ** 6, 0.0)
    return np.asarray(reach @ power)


def _shrunk_phases(own: Float, waves: Float, weight: Float, shape: Float) -> Float:
    """Phases of rings, shrunk by their number of waves to a common multiple of a shape, a mean with weights.
    Phases beyond pi were measured as much below it: they are turned back where longer waves predict so.
    """
    if not waves.any():
        return np.zeros_like(own)
    ratio, total, weights, mean = np.zeros_like(own), 0.0, 0.0, 0.0
    for ring in np.flatnonzero(waves):
        beyond = total > _HALF_TRUSTED_WAVES and shape[ring] * np.exp(mean) > np.pi
        ratio[ring] = np.log((2.0 * np.pi - own[ring] if beyond else own[ring]) / shape[ring])
        total += waves[ring]
        weights += weight[ring]
        mean += (ratio[ring] - mean) * weight[ring] / weights
    share = waves / (waves + _HALF_TRUSTED_WAVES)
    return np.asarray(np.minimum(shape * np.exp(share * ratio + (1.0 - share) * mean), _MAX_PHASE))


def _rings(shape: tuple[int, ...]) -> tuple[NDArray[np.int64], Float, Float]:
    """Ring of every line of the discrete Fourier transform, its wavenumber, rad per node,
    and the square of its curvature (`_curvature`) over its height; 1 where it has none.
    """
    ky, kx = (scipy.fft.fftfreq(n) for n in shape)
    k = np.hypot(kx, ky[:, None]).ravel()
    bent = (4.0 - 2.0 * np.cos(2.0 * np.pi * kx) - 2.0 * np.cos(2.0 * np.pi * ky[:, None])).ravel()
    return np.rint(k * max(shape)).astype(int), 2.0 * np.pi * k, np.where(bent > 0, bent, 1.0) ** 2


def _curvature(field: Float) -> Float:
    """Four times a field less its four neighbours, without the outermost nodes."""
    return np.asarray(
        4.0 * _inner(field) - field[2:, 1:-1] - field[:-2, 1:-1] - field[1:-1, 2:] - field[1:-1, :-2]
    )


def _inner(field: Float) -> Float:
    return field[1:-1, 1:-1]


def _phase(plus: Float, minus: Float) -> Float:
    """Phase per step of waves, rad, from the power of the sum and of the difference of two frames."""
    return np.asarray(2.0 * np.arctan2(np.sqrt(minus), np.sqrt(plus)))


def _power(field: Float) -> Float:
    """Power of every wave of a field; it sums to the field's variance."""
    ny, nx = field.shape
    window = np.outer(np.hanning(ny + 2)[1:-1], np.hanning(nx + 2)[1:-1])
    cut = (field - np.sum(field * window) / np.sum(window)) * window
    power = np.square(np.abs(scipy.fft.fft2(cut, workers=1))) / (np.sum(window**2) * field.size)
    return np.asarray(power.ravel())


def typical_size(field: Float, measured: NDArray[np.bool_]) -> Float:
    """Rms of a field (ny, nx), half here, half elsewhere: errors do not vanish where the field is zero."""
    elsewhere = np.nanmean(np.square(field[measured])) if measured.any() else 0.0
    return np.asarray(np.sqrt(0.5 * (np.square(field) + elsewhere)))
