"""What frames so far apart cannot follow: how fast the waves of a record turn, and what that leaves out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

Float = NDArray[Any]

_HEARD = 6.0  # times its noise: what the power of a ring must be to tell of its waves
_LEAKED = 1e-3  # of the strongest ring: less may have come through the window
_PER_WAVE = 4.5  # lines of a windowed transform that tell the same
_FEW = 20.0  # waves: a ring of so many is believed by half
_BESIDE = 1.1  # a chord lies beside the path as well: the more, the steeper the waves


@dataclass(frozen=True)
class Unresolved:
    """Standard deviation of what the finite time step leaves out, over the field.

    Parameters
    ----------
    z : tuple of (int, float)
        Of z at mid-time from 2, 3, 4 and 6 frames, metres.
    d : tuple of (int, float)
        Of the water's displacement per step from 2 and 4 frames, over its own standard deviation.
    """

    z: tuple[tuple[int, float], ...]  # pairs, for a plan is looked up by what it was learned from
    d: tuple[tuple[int, float], ...]

    def of_z(self, frames: int) -> float:
        """Of z at mid-time from so many frames, metres."""
        return dict(self.z)[frames]

    def of_displacement(self, frames: int) -> float:
        """Of the displacement per step from so many frames, over its own standard deviation."""
        return dict(self.d)[frames]

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a recipe.

        Returns
        -------
        dict
        """
        return {key: {str(n): value for n, value in part} for key, part in vars(self).items()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Unresolved:
        """Inverse of `to_dict`.

        Parameters
        ----------
        data : mapping
            As given by `to_dict`.

        Returns
        -------
        Unresolved
        """
        parts = (tuple((int(n), float(value)) for n, value in data[key].items()) for key in ("z", "d"))
        return cls(*parts)


NOTHING = Unresolved(tuple((n, 0.0) for n in (2, 3, 4, 6)), tuple((n, 0.0) for n in (2, 4)))


def kept_of_z(phase: Float, frames: int) -> Float:
    """Fraction of a wave's elevation at mid-time that an interpolation in time keeps.

    Parameters
    ----------
    phase : ndarray
        omega dt, rad.
    frames : int
        2, 4 or 6 of them.

    Returns
    -------
    ndarray

    Examples
    --------
    >>> kept_of_z(np.array([1.0]), 6).round(4).tolist(), kept_of_z(np.array([1.0]), 4).round(4).tolist()
    ([0.9958], [0.9784])
    """
    weights = {2: (1.0,), 4: (9 / 8, -1 / 8), 6: (150 / 128, -25 / 128, 3 / 128)}[frames]
    return np.asarray(sum(w * np.cos((n + 0.5) * phase) for n, w in enumerate(weights)))


def kept_of_displacement(phase: Float, frames: int) -> Float:
    """Fraction of a wave's velocity at mid-time that displacements keep.

    Parameters
    ----------
    phase : ndarray
        omega dt, rad.
    frames : int
        2 for a chord, 4 for a path through four places.

    Returns
    -------
    ndarray
    """
    path = 1.0 if frames == 2 else (26.0 - 2.0 * np.cos(phase)) / 24.0
    return np.asarray(np.sinc(phase / (2.0 * np.pi)) * path)


def unresolved(
    pairs: Sequence[tuple[Float, Float]], noise: Callable[[Float], Float] | None = None
) -> Unresolved:
    """What the finite time step leaves out, from elevations at two consecutive frames.

    Parameters
    ----------
    pairs : sequence of (ndarray, ndarray), each (ny, nx)
        Elevation at a frame and at the next, of sample steps, metres.
    noise : callable, optional
        From wavenumbers, rad per node, to the noise in the power of every wave of the discrete Fourier
        transform, metres squared; none if left out. It turns at any speed, and must not pass for waves.

    Returns
    -------
    Unresolved

    Notes
    -----
    In every ring of wavenumber the power of the difference over that of the sum is tan^2(p/2), with p = omega
    dt the phase by which its waves turn in a step; the power of the waves is the sum of both, over four. A
    ring of few waves says little of its own: its phase is drawn to c sqrt(k), with c the mean of all rings,
    weighed by their waves. What is left out follows from p by linear theory (`kept_of_z`,
    `kept_of_displacement`); three frames leave out p^3/16. A window in space keeps the long waves out of the
    rings of the short ones.
    """
    if not pairs:
        return NOTHING
    ring, k = _rings(pairs[0][0].shape)
    drowned = np.zeros(int(ring.max()) + 1) if noise is None else 2.0 * np.bincount(ring, noise(k))
    plus, minus = (
        np.maximum(np.mean([np.bincount(ring, _power(a + sign * b)) for a, b in pairs], axis=0) - drowned, 0)
        for sign in (1.0, -1.0)
    )
    count = np.bincount(ring)
    own = 2.0 * np.arctan2(np.sqrt(minus), np.sqrt(plus))
    power = 0.25 * (plus + minus)
    heard = (power > 0.25 * _HEARD * drowned) & (power > _LEAKED * power.max()) & (own > 0)
    heard[0] = False
    waves = np.where(heard, count * len(pairs) / _PER_WAVE, 0.0)
    phase = _drawn(own, waves, np.bincount(ring, k) / count)
    z = {n: float(np.sqrt(np.sum(power * (1.0 - kept_of_z(phase, n)) ** 2))) for n in (2, 4, 6)}
    z[3] = float(np.sqrt(np.sum(power * np.minimum(phase**3 / 16.0, 1.0) ** 2)))
    moved = power * phase**2
    d = {}
    for n, factor in ((2, _BESIDE), (4, 1.0)):
        lost = factor * (1.0 - kept_of_displacement(phase, n))
        d[n] = float(np.sqrt(np.sum(moved * lost**2) / max(np.sum(moved), 1e-30)))
    return Unresolved(tuple(sorted(z.items())), tuple(d.items()))


def _drawn(own: Float, waves: Float, k: Float) -> Float:
    """Phases of rings as they and all others together have them."""
    if not waves.any():
        return np.zeros_like(own)
    shape = np.sqrt(k)
    heard = waves > 0
    ratio = np.zeros_like(own)
    ratio[heard] = np.log(own[heard] / shape[heard])
    mean = np.sum(waves * ratio) / np.sum(waves)
    share = waves / (waves + _FEW)
    return np.asarray(np.minimum(shape * np.exp(share * ratio + (1.0 - share) * mean), np.pi))


def _rings(shape: tuple[int, ...]) -> tuple[NDArray[np.int64], Float]:
    """Ring of every wave of the discrete Fourier transform, and its wavenumber, rad per node."""
    ky, kx = (scipy.fft.fftfreq(n) for n in shape)
    k = np.hypot(kx, ky[:, None]).ravel()
    return np.rint(k * max(shape)).astype(int), 2.0 * np.pi * k


def _power(field: Float) -> Float:
    """Power of every wave of a field; it sums to the field's variance."""
    ny, nx = field.shape
    window = np.outer(np.hanning(ny + 2)[1:-1], np.hanning(nx + 2)[1:-1])
    cut = (field - np.sum(field * window) / np.sum(window)) * window
    power = np.square(np.abs(scipy.fft.fft2(cut, workers=1))) / (np.sum(window**2) * field.size)
    return np.asarray(power.ravel())


def typical(field: Float, inside: NDArray[np.bool_]) -> Float:
    """Half what is here, half what is elsewhere: errors do not vanish where a field passes through zero.

    Parameters
    ----------
    field : ndarray, (ny, nx)
        Any field.
    inside : ndarray of bool, (ny, nx)
        Nodes that count.

    Returns
    -------
    ndarray, (ny, nx)
    """
    elsewhere = np.nanmean(np.square(field[inside])) if inside.any() else 0.0
    return np.asarray(np.sqrt(0.5 * (np.square(field) + elsewhere)))
