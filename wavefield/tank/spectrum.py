"""Free waves of a random sea, drawn from a spectrum."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from wavefield.water import dispersion

Array = NDArray[np.float64]


def jonswap(f: Array, peak: float, enhancement: float = 3.3) -> Array:
    """JONSWAP shape of the elevation's frequency spectrum.

    With f, Hz; peak, Hz.
    """
    width = np.where(f <= peak, 0.07, 0.09)
    bump = enhancement ** np.exp(-((f / peak - 1) ** 2) / (2 * width**2))
    out: Array = f**-5.0 * np.exp(-1.25 * (peak / f) ** 4) * bump
    return out


def power_law(f: Array, peak: float, exponent: float = 6.0) -> Array:
    """Spectrum that falls as a power of the frequency above its peak, as in wave turbulence.

    With f, Hz; peak, Hz.
    """
    return f**-exponent * np.exp(-exponent / 4 * (peak / f) ** 4)


def spreading(angle: Array, exponent: float) -> Array:
    """Directional distribution cos^2s of half the angle from the main direction.

    With angle, rad.
    """
    return np.cos(angle / 2) ** (2 * exponent)


def random_waves(
    shape: Callable[[Array], Array],
    *,
    rms: float,
    direction: float,
    spread: float,
    shortest: float,
    longest: float = np.inf,
    period: float,
    depth: float,
    surface_tension: float,
    seed: int,
) -> tuple[Array, Array, NDArray[np.complex128]]:
    """Draw the waves of a Gaussian sea on a square lattice of wave vectors.

    The density over wave vectors is S(f) (df/dk) D(theta) / k; amplitudes are complex Gaussian, so that the
    elevation is Gaussian and spectra fluctuate as in nature.

    With shortest, longest, metres; period, metres; depth, metres; returns kx, ky (n,): Wave vectors, rad/m;
    amplitude (n,): Amplitudes, metres.
    """
    dk = 2 * np.pi / period
    m = np.arange(-int(period / shortest), int(period / shortest) + 1)
    kx, ky = (a.ravel() for a in np.meshgrid(m * dk, m * dk))
    k = np.hypot(kx, ky)
    keep = (k > 0) & (k <= 2 * np.pi / shortest * (1 + 1e-9)) & (k >= 2 * np.pi / longest * (1 - 1e-9))
    kx, ky, k = kx[keep], ky[keep], k[keep]
    frequency = dispersion(k, depth, surface_tension) / (2 * np.pi)
    nudge = 1e-6 * k
    slope = dispersion(k + nudge, depth, surface_tension) / (2 * np.pi) - frequency
    density = shape(frequency) * (slope / nudge) / k * spreading(np.arctan2(ky, kx) - direction, spread)
    rng = np.random.default_rng([seed, 4])
    draw = rng.standard_normal((2, k.size))
    amplitude = np.sqrt(density) * (draw[0] + 1j * draw[1])
    amplitude *= rms / np.sqrt(0.5 * np.sum(np.abs(amplitude) ** 2))
    # waves below a millionth of the rms cost as much as the others and show nowhere
    seen = np.abs(amplitude) > 1e-6 * rms
    return kx[seen], ky[seen], amplitude[seen]
