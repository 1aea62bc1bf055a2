"""Exact periodic waves of permanent form on deep water, from Babenko's equation, for judging estimators.

Shares no code with the package. Gravity alone; lengths in 1/k and times in 1/sqrt(g k) until they are scaled.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

GRAVITY = 9.81
_POINTS, _LINES = 384, 128  # of a wave, in the conformal coordinate: products of two series are exact


def _modes(values):
    """|k| y of periodic values y."""
    number = np.arange(values.shape[-1] // 2 + 1)
    return np.fft.irfft(np.fft.rfft(values) * number, values.shape[-1])


def _series(lines):
    """Values of cosine series (..., lines)."""
    padded = np.zeros((*lines.shape[:-1], _POINTS // 2 + 1))
    padded[..., : lines.shape[-1]] = lines / 2
    padded[..., 0] *= 2
    return np.fft.irfft(padded, _POINTS) * _POINTS


@lru_cache
def _shape(steepness):
    """Elevation y over the conformal coordinate, and speed, for k = g = 1 and half the height `steepness`."""
    number = np.arange(_LINES)

    def misfit(unknown, height):
        lines, square = unknown[..., :-1], unknown[..., -1:]
        y = _series(lines)
        products = np.fft.rfft(y * _modes(y) + _modes(y**2) / 2).real[..., :_LINES] / _POINTS
        products[..., 1:] *= 2
        off = lines[..., 1::2].sum(axis=-1, keepdims=True) - height
        return np.concatenate([(square * number - 1) * lines - products, off], axis=-1)

    found = np.r_[0.0, 0.01, np.zeros(_LINES - 2), 1.0]
    for height in np.linspace(0.01, steepness, max(2, int(steepness / 0.07) + 1)):
        for _ in range(12):
            now = misfit(found, height)
            slopes = (misfit(found + 1e-7 * np.eye(found.size), height) - now) / 1e-7
            found = found - np.linalg.solve(slopes.T, now)
            if np.abs(now).max() < 1e-10:
                break
        else:
            raise ArithmeticError(f"no wave of steepness {height:.3f} was found")
    return _series(found[:-1]), float(np.sqrt(found[-1]))


@dataclass(frozen=True)
class SteadyWave:
    """One wave: half its height times its wavenumber, its length (m), heading (rad) and the current (m/s)."""

    steepness: float
    length: float = 0.5
    heading: float = 0.0
    current: tuple = (0.0, 0.0)

    @property
    def speed(self):
        """Relative to the water far below, m/s."""
        return _shape(self.steepness)[1] * np.sqrt(GRAVITY * self.length / (2 * np.pi))

    @property
    def ratio(self):
        """Speed of the water at the crest over that of the crest."""
        return 1 - 1 / (1 + _modes(_shape(self.steepness)[0])[0])

    def fields(self, t, y, x):
        """z, z_t, u, v, w of the moment (time, y, x)."""
        elevation, speed = _shape(self.steepness)
        k, n = 2 * np.pi / self.length, elevation.size
        lines = np.fft.rfft(elevation)
        xi = 2 * np.pi * np.arange(n) / n
        along = _modes(elevation)  # x = xi - H[y]: x' = 1 + |k| y
        shift = np.fft.irfft(-1j * lines * (np.arange(lines.size) > 0), n)
        slope = np.fft.irfft(1j * np.arange(lines.size) * lines, n)
        tangent = 1 + along + 1j * slope
        velocity = speed * (1 - 1 / tangent)  # u - i w
        place, scale = xi + shift, np.sqrt(GRAVITY / k)
        towards = np.array([np.cos(self.heading), np.sin(self.heading)])
        drift = float(np.dot(self.current, towards))
        phase = k * (towards[0] * x + towards[1] * y[:, None] - (self.speed + drift) * t[:, None, None])

        def at(values):
            order = np.r_[np.arange(n), 0]
            turns = np.r_[place, place[0] + 2 * np.pi]
            wrapped = (phase - place[0]) % (2 * np.pi) + place[0]
            return CubicSpline(turns, values[order], bc_type="periodic")(wrapped)

        u, z_x = scale * at(velocity.real), at(slope / (1 + along))
        out = {"z": at(elevation) / k, "z_t": -(self.speed + drift) * z_x, "w": -scale * at(velocity.imag)}
        return out | {"u": self.current[0] + towards[0] * u, "v": self.current[1] + towards[1] * u}
