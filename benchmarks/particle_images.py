"""Simulated pairs of particle images, 1024 x 1024 px, with exactly known displacement."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

N = 1024
_PAD = 64
Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Field = Callable[[Array, Array], tuple[Array, Array]]


def uniform(u: float, v: float) -> Field:
    return lambda x, y: (np.full_like(x, u), np.full_like(x, v))


def sinusoid(amplitude: float, wavelength: float) -> Field:
    """Each component varies across its own direction."""
    k = 2 * np.pi / wavelength
    return lambda x, y: (amplitude * np.sin(k * y), amplitude * np.sin(k * x))


def cellular(amplitude: float, wavelength: float = 200.0) -> Field:
    """Both components wave along the diagonals; the gradient is 2 pi amplitude / wavelength."""
    k = 2 * np.pi / wavelength / np.sqrt(2)
    return lambda x, y: (amplitude * np.sin(k * (x + y)), amplitude * np.cos(k * (x - y)))


def parallax() -> Field:
    """As between two cameras: 0 to 40 px, gradient up to .15."""

    def field(x: Array, y: Array) -> tuple[Array, Array]:
        u = 20 + 14 * np.sin(2 * np.pi * x / 840 + 0.3) + 4 * np.sin(2 * np.pi * y / 700)
        return u + 2 * np.sin(2 * np.pi * (x * 0.8 + y * 0.6) / 280), np.sin(2 * np.pi * y / 500)

    return field


def other_camera(image: Array) -> Array:
    """The same picture with another gain and offset, both varying over it."""
    y, x = np.mgrid[:N, :N]
    gain = 0.7 + 0.5 * np.sin(2 * np.pi * x / 1500) * np.cos(2 * np.pi * y / 1300)
    return np.asarray(image * gain + 12 + 8 * np.sin(y / 150))


def _render(x: Array, y: Array, light: Array, sigma: float) -> Array:
    """Gaussian particles, integrated over pixels."""
    reach = 4 if sigma < 1 else 6
    seen = (x > -reach) & (x < N + reach) & (y > -reach) & (y < N + reach)
    x, y, light = x[seen], y[seen], light[seen]
    i, j = np.rint(x).astype(int), np.rint(y).astype(int)
    offset = np.arange(-reach, reach + 1)

    def share(place: Array, pixel: NDArray[np.int_]) -> Array:
        d = (place - pixel)[:, None] - offset
        edges = [erf((d + half) / (sigma * np.sqrt(2))) for half in (0.5, -0.5)]
        return np.asarray(0.5 * (edges[0] - edges[1]))

    value = 2 * np.pi * sigma**2 * light[:, None, None] * share(y, j)[:, :, None] * share(x, i)[:, None, :]
    column = np.broadcast_to(i[:, None, None] + offset[None, None, :], value.shape)
    row = np.broadcast_to(j[:, None, None] + offset[None, :, None], value.shape)
    inside = (column >= 0) & (column < N) & (row >= 0) & (row < N)
    return np.bincount(row[inside] * N + column[inside], value[inside], minlength=N * N).reshape(N, N)


def particles(
    field: Field,
    density: float = 0.03,
    sigma: float = 0.675,
    unmatched: float = 0.0,
    noise: float = 0.0,
    lit: bool = False,
    seed: int = 3,
) -> tuple[Image, Image]:
    """Two images of particles that move by ``field`` of the middle of their paths.

    Particles per px, the standard deviation of one (px), the part that only one image shows, noise as a part
    of 255 grey levels; ``lit``: the second image is that of a camera with another gain.
    """
    rng = np.random.default_rng(seed)
    n = int(density * (N + 2 * _PAD) ** 2)
    x, y = rng.uniform(-_PAD, N + _PAD, (2, n))
    light = rng.uniform(60, 220, n)
    u, v = field(x, y)
    x2, y2 = x + u / 2, y + v / 2
    lost = rng.random(n) < unmatched
    x2[lost], y2[lost] = rng.uniform(-_PAD, N + _PAD, (2, lost.sum()))
    a = _render(x - u / 2, y - v / 2, light, sigma) + 8
    b = _render(x2, y2, light, sigma) + 8
    pair = (a, other_camera(b) if lit else b)
    noisy = (image + rng.normal(0, noise * 255, image.shape) for image in pair)
    first, second = (np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in noisy)
    return first, second
