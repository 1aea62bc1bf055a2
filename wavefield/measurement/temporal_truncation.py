"""What frames so far apart cannot follow: how fast the waves of a record turn, and what that leaves out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavefield.variables import PATH_WEIGHTS
from wavefield.water import dispersion

Float = NDArray[Any]
Parts = tuple[float, float, float, float]

_DETECTED_SNR = 6.0  # times its noise: what the power of a ring must be to tell of its waves
_LEAKED = 0.5  # of a ring, by Hann window, so many rings further to the power of -6
_MAIN = 3  # rings: nearer than that a window mixes them
_TURNS = 16  # directions of waves to the water's own
_SMALLEST = 6  # nodes along either side, to tell waves
_PER_WAVE = 4.5  # lines of a windowed transform that tell the same
_FEW = 20.0  # waves: a ring of so many is believed by half
_ENOUGH = 100.0  # waves: so many tell to a tenth how fast they turn, and to half of it what six frames lose
_BESIDE = 1.1  # a chord lies beside the path as well: the more, the steeper the waves


@dataclass(frozen=True)
class TemporalTruncation:
    """Standard deviation of what the finite time step leaves out, over the field."""

    z: tuple[tuple[int, float], ...]  # pairs, for a plan is looked up by what it was learned from
    # (float, float, float, float): Of the water's displacement per step from 2, 4 and, where enough waves
    # tell it, 6 frames, over the rms of its rise: along either axis, where the water stands still and by how
    # much more where it moves as far as it does on the average (squares add), then the same of its rise
    d: tuple[tuple[int, Parts], ...]

    def of_z(self, frames: int) -> float:
        """Of z at mid-time from so many frames, metres."""
        return dict(self.z)[frames]

    def of_displacement(self, frames: int, d: Float, known: NDArray[np.bool_]) -> Float:
        """Of the displacement per step from so many frames.

        Half of what is left out along the axes is shared as the motion itself is, half evenly: short waves
        come from more sides than long ones.

        With d (3, ny, nx), metres; known (ny, nx); returns (3, ny, nx): Metres.
        """
        still, moving, still_up, moving_up = np.square(dict(self.d)[frames])
        if not known.any():
            return np.zeros_like(d)
        x, y = (float(np.var(part[known])) for part in d[:2])
        share = 0.5 + 0.5 * np.array([x, y]) * 2.0 / max(x + y, 1e-30)
        speed = np.square(d[0]) + np.square(d[1])
        speed /= max(float(np.mean(speed[known])), 1e-30)
        up = still_up + moving_up * speed
        along = still + moving * speed
        rise = np.float32(np.sqrt(np.mean(np.square(d[2][known]))))
        return np.asarray(rise * np.sqrt(np.stack([share[0] * along, share[1] * along, up])))

    def total(self, frames: int) -> float:
        """Variance of the displacement per step from so many frames, over that of the rise."""
        still, moving, still_up, moving_up = np.square(dict(self.d)[frames])
        return float(2.0 * (still + moving) + still_up + moving_up)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a recipe."""
        z, d = {str(n): value for n, value in self.z}, {str(n): list(parts) for n, parts in self.d}
        return {"z": z, "d": d}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TemporalTruncation:
        """Inverse of `to_dict`."""
        z = tuple((int(n), float(value)) for n, value in data["z"].items())
        return cls(z, tuple((int(n), _parts(value)) for n, value in data["d"].items()))


def _parts(value: Sequence[float]) -> Parts:
    across, more, up, more_up = map(float, value)
    return across, more, up, more_up


NOTHING = TemporalTruncation(
    tuple((n, 0.0) for n in (2, 3, 4, 6)), tuple((n, (0.0, 0.0, 0.0, 0.0)) for n in (2, 4))
)


def kept_of_z(phase: Float, frames: int) -> Float:
    """Fraction of a wave's elevation at mid-time that an interpolation in time keeps.

    Examples
    --------
    >>> kept_of_z(np.array([1.0]), 6).round(4).tolist(), kept_of_z(np.array([1.0]), 4).round(4).tolist()
    ([0.9958], [0.9784])
    """
    weights = {2: (1.0,), 4: (9 / 8, -1 / 8), 6: (150 / 128, -25 / 128, 3 / 128)}[frames]
    return np.asarray(sum(w * np.cos((n + 0.5) * phase) for n, w in enumerate(weights)))


def kept_of_displacement(phase: Float, frames: int) -> Float:
    """Fraction of a wave's velocity at mid-time that displacements keep.

    With phase, rad.
    """
    here, *beside = PATH_WEIGHTS[frames]
    path = here + 2.0 * sum(w * np.cos(n * phase) for n, w in enumerate(beside, 1))
    return np.asarray(np.sinc(phase / (2.0 * np.pi)) * path)


def temporal_truncation(
    pairs: Sequence[tuple[Float, Float]],
    step: float,
    noise: Callable[[Float], Float] | None = None,
    matched: Callable[[Float], tuple[Float, Float]] | None = None,
) -> TemporalTruncation:
    """What the finite time step leaves out, from elevations at two consecutive frames.

    In every ring of wavenumber the power of the difference over that of the sum is tan^2(p/2), with p = omega
    dt the phase by which its waves turn in a step; the power P of the waves is the sum of both, over four. A
    ring of few waves says little of its own: its phase is drawn to c times that of the dispersion relation,
    with c the mean of all rings, weighed by their waves. A window in space keeps the long waves out of the
    rings of the short ones, but for what falls off with the sixth power of the distance: rings that this may
    fill are drawn altogether. All this of the curvature of z: waves as long as the field and longer would
    fill the first rings with their own slow turning. What z has there beyond its curvature is theirs, a ring
    of its own. Of z sum P (1 - K)^2 is left out (`kept_of_z`); three frames leave out p^3/16.

    A path sees a wave turn by q = p - k d cos(theta) in a step, with d how far the water moves in it, theta
    the direction of the wave beside that of the water; along the path its rise is q of the amplitude, its
    motion along the wave p of it. Of its displacement B G is left by matching, B G K(q) by the path as well
    (`kept_of_displacement`); what the prior takes, (1 - G)^2, is stated apart. So half of sum P p^2 L of the
    motion along either axis is left out, L = (1 - B G K(q))^2 - (1 - G)^2, averaged over theta. Of the rise
    sum P q^2 L is, but for how much the path bends: its places are Gaussian, given d, and the expectation of
    the squared error follows from their covariances. Both grow nearly with d^2. d is that of deep water: as
    far as it rises.

    With pairs (ndarray, ndarray), metres; step, metres; noise, rad per node; matched, rad per node.
    """
    if not pairs or min(pairs[0][0].shape) < _SMALLEST:
        return NOTHING
    shape = pairs[0][0].shape
    inner = shape[0] - 2, shape[1] - 2
    ring, k, square = _rings(inner)
    count = np.bincount(ring)
    noise_power = np.zeros(count.size)
    if noise is not None:  # in the power of every wave of a smaller field there is more of it
        noise_power = 2.0 * np.bincount(ring, noise(k)) * np.prod(shape) / np.prod(inner)

    def in_rings(combine: Callable[[Float], Float], sign: float, weight: Float) -> Float:
        powers = [np.bincount(ring, weight * _power(combine(a + sign * b))) for a, b in pairs]
        return np.asarray(np.maximum(np.mean(powers, axis=0) - noise_power, 0.0))

    flat = np.ones_like(k)
    curved = [in_rings(_curvature, sign, 1.0 / square) for sign in (1.0, -1.0)]
    whole = [in_rings(_inner, sign, flat) for sign in (1.0, -1.0)]
    plus, minus = np.minimum(curved, whole)
    own = _turned(*curved)
    power, curvature = (
        0.25 * (plus + minus),
        0.25 * np.sum(curved, axis=0) * np.bincount(ring, square) / count,
    )
    detected = (
        (power > 0.25 * _DETECTED_SNR * noise_power)
        & (curvature > _DETECTED_SNR * _leaked(curvature))
        & (own > 0)
    )
    detected[0] = False
    peak = 1 + int(np.argmax(power[1:]))  # what is heard again beyond a ring that is not is noise
    detected[peak:] = np.logical_and.accumulate(detected[peak:])
    waves = np.where(detected, count * len(pairs) / _PER_WAVE, 0.0)
    k = np.bincount(ring, k) / count / step
    phase = _drawn(own, waves, dispersion(k))
    longer = np.sum(whole, axis=1) - [plus[1:].sum(), minus[1:].sum()]
    power[0], phase[0] = 0.25 * longer.sum(), _turned(*longer)
    z = {n: float(np.sqrt(np.sum(power * (1.0 - kept_of_z(phase, n)) ** 2))) for n in (2, 4, 6)}
    z[3] = float(np.sqrt(np.sum(power * np.minimum(phase**3 / 16.0, 1.0) ** 2)))
    left = (np.ones_like(k), np.ones_like(k)) if matched is None else matched(k * step)
    rise = float(np.mean([np.mean(np.square(b - a)) for a, b in pairs]))
    d = []
    factors = {2: _BESIDE, 4: 1.0} | ({6: 1.0} if waves.sum() > _ENOUGH else {})
    for n, factor in factors.items():
        still, moving = (_of_paths(power, phase, k, far, left, n) for far in (0.0, np.sqrt(rise)))
        faster = np.maximum(moving - still, 0.0)
        across, up = factor * np.sqrt(np.stack([still, faster], axis=1) / max(rise, 1e-30))
        d.append((n, (float(across[0]), float(across[1]), float(up[0]), float(up[1]))))
    return TemporalTruncation(tuple(sorted(z.items())), tuple(d))


def _of_paths(
    power: Float, phase: Float, k: Float, far: float, left: tuple[Float, Float], frames: int
) -> Float:
    """Variance that paths leave out along either axis and of the rise, (2,), where water moves so far."""
    theta = np.pi * (np.arange(_TURNS) + 0.5) / _TURNS
    moved = far * k * np.cos(theta)[:, None]
    gain, raised = left
    q = phase - moved
    lost = np.square(1.0 - raised * gain * kept_of_displacement(q, frames)) - np.square(1.0 - gain)
    along = 0.5 * np.sum(power * phase**2 * np.maximum(lost, 0.0))
    risen = _of_rises(power, phase, k, moved, raised * gain, frames) - np.square((1.0 - gain) * q)
    return np.array([along, np.sum(power * np.maximum(risen, 0.0))]) / _TURNS


def _of_rises(power: Float, phase: Float, k: Float, moved: Float, left: Float, frames: int) -> Float:
    """Squared error of the rise along a path, over the power of each wave, (turns, rings).

    Where the path leads is a Gaussian process: known is how far it goes in a step at mid-time, what is left
    of it turns the wave as well.
    """
    t, weights = _places(frames)
    apart, each = np.subtract.outer(t, t)[..., None], np.multiply.outer(t, phase)
    still = 1.0 - np.cos(each)
    # covariances of the places, from mid-time on, and with the motion there; along one axis
    places = 0.5 * ((np.cos(apart * phase) - 1.0 + still[:, None] + still[None]) @ power)
    with_motion, motion = 0.5 * (phase * np.sin(each)) @ power, 0.5 * np.sum(power * phase**2)
    rho = with_motion / max(motion, 1e-30)
    rest = places - np.outer(with_motion, rho)
    own = np.diag(rest)
    between = own[:, None] + own - 2.0 * rest
    seen = left * weights[:, None] * np.exp(1j * (each - moved[:, None] * rho[:, None]))
    exact = phase - moved
    mean = np.sum(seen * np.exp(-0.5 * np.multiply.outer(own, k**2)), axis=1)
    pairs = np.real(seen[:, :, None] * seen[:, None].conj()) * np.exp(-0.5 * np.multiply.outer(between, k**2))
    return np.asarray(np.square(exact) - 2.0 * exact * np.imag(mean) + pairs.sum(axis=(1, 2)))


def _places(frames: int) -> tuple[Float, Float]:
    """When a path is seen, steps from mid-time, and what its places weigh in the displacement there."""
    t = np.arange(frames) - 0.5 * (frames - 1)
    later = -np.diff(PATH_WEIGHTS[frames], append=0.0)
    return t, np.concatenate([-later[::-1], later])


def _leaked(power: Float) -> Float:
    """Power that the window brings into every ring from those that are not beside it."""
    apart = np.abs(np.subtract.outer(np.arange(power.size), np.arange(power.size)))
    reach = np.where(apart >= _MAIN, _LEAKED / np.maximum(apart, 1.0) ** 6, 0.0)
    return np.asarray(reach @ power)


def _drawn(own: Float, waves: Float, shape: Float) -> Float:
    """Phases of rings as they and all others together have them, in proportion to a shape."""
    if not waves.any():
        return np.zeros_like(own)
    detected = waves > 0
    ratio = np.zeros_like(own)
    ratio[detected] = np.log(own[detected] / shape[detected])
    mean = np.sum(waves * ratio) / np.sum(waves)
    share = waves / (waves + _FEW)
    return np.asarray(np.minimum(shape * np.exp(share * ratio + (1.0 - share) * mean), np.pi))


def _rings(shape: tuple[int, ...]) -> tuple[NDArray[np.int64], Float, Float]:
    """Ring of every wave of the discrete Fourier transform, its wavenumber, rad per node.

    And the square of its curvature (`_curvature`) over its height; 1 where it has none.
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


def _turned(plus: Float, minus: Float) -> Float:
    """Phase by which waves turn in a step, from the power of the sum and of the difference of two."""
    return np.asarray(2.0 * np.arctan2(np.sqrt(minus), np.sqrt(plus)))


def _power(field: Float) -> Float:
    """Power of every wave of a field; it sums to the field's variance."""
    ny, nx = field.shape
    window = np.outer(np.hanning(ny + 2)[1:-1], np.hanning(nx + 2)[1:-1])
    cut = (field - np.sum(field * window) / np.sum(window)) * window
    power = np.square(np.abs(scipy.fft.fft2(cut, workers=1))) / (np.sum(window**2) * field.size)
    return np.asarray(power.ravel())


def typical(field: Float, inside: NDArray[np.bool_]) -> Float:
    """Half what is here, half what is elsewhere: errors do not vanish where a field passes through zero.

    With field (ny, nx); inside (ny, nx); returns (ny, nx).
    """
    elsewhere = np.nanmean(np.square(field[inside])) if inside.any() else 0.0
    return np.asarray(np.sqrt(0.5 * (np.square(field) + elsewhere)))
