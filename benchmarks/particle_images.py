"""Simulated particle and texture pairs of 1024 x 1024 px with exactly known displacement."""

from collections.abc import Callable

import numpy as np
from scipy import ndimage
from scipy.special import erf

N = 1024
_PAD = 64
Field = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def uniform(u: float, v: float) -> Field:
    return lambda x, y: (np.full_like(x, u), np.full_like(x, v))


def cellular(amplitude: float, wavelength: float = 200.0) -> Field:
    """Both components wave along the diagonals; the gradient is 2 pi amplitude / wavelength."""
    k = 2 * np.pi / wavelength / np.sqrt(2)
    return lambda x, y: (amplitude * np.sin(k * (x + y)), amplitude * np.cos(k * (x - y)))


def shear_wave(wavelength: float) -> Field:
    return lambda x, y: (np.sin(2 * np.pi * y / wavelength) + 0 * x, 0.3 + 0 * x)


def parallax(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stereo-like: 0 to 40 px, gradient up to .15."""
    u = 20 + 14 * np.sin(2 * np.pi * x / 840 + 0.3) + 4 * np.sin(2 * np.pi * y / 700)
    return u + 2 * np.sin(2 * np.pi * (x * 0.8 + y * 0.6) / 280), np.sin(2 * np.pi * y / 500)


def holes(share: float = 0.1, seed: int = 5) -> np.ndarray:
    """Discs without particles, covering this share of the image."""
    rng = np.random.default_rng(seed)
    mask = np.zeros((N, N), bool)
    y, x = np.mgrid[:N, :N]
    while mask.mean() < share:
        cx, cy, r = rng.uniform(60, N - 60), rng.uniform(60, N - 60), rng.uniform(25, 45)
        mask |= (x - cx) ** 2 + (y - cy) ** 2 < r * r
    return mask


def other_camera(image: np.ndarray) -> np.ndarray:
    """The same picture with another gain and offset, both varying over it."""
    y, x = np.mgrid[:N, :N]
    return (
        image * (0.7 + 0.5 * np.sin(2 * np.pi * x / 1500) * np.cos(2 * np.pi * y / 1300))
        + 12
        + 8 * np.sin(y / 150)
    )


def _render(x: np.ndarray, y: np.ndarray, light: np.ndarray, sigma: float) -> np.ndarray:
    reach = 4 if sigma < 1 else 6
    seen = (x > -reach) & (x < N + reach) & (y > -reach) & (y < N + reach)
    x, y, light = x[seen], y[seen], light[seen]
    i, j = np.rint(x).astype(int), np.rint(y).astype(int)
    offset = np.arange(-reach, reach + 1)

    def share(place: np.ndarray, pixel: np.ndarray) -> np.ndarray:
        d = (place - pixel)[:, None] - offset
        return 0.5 * (erf((d + 0.5) / (sigma * np.sqrt(2))) - erf((d - 0.5) / (sigma * np.sqrt(2))))

    value = 2 * np.pi * sigma**2 * light[:, None, None] * share(y, j)[:, :, None] * share(x, i)[:, None, :]
    column = np.broadcast_to(i[:, None, None] + offset[None, None, :], value.shape)
    row = np.broadcast_to(j[:, None, None] + offset[None, :, None], value.shape)
    inside = (column >= 0) & (column < N) & (row >= 0) & (row < N)
    return np.bincount(row[inside] * N + column[inside], value[inside], minlength=N * N).reshape(N, N)


def _eight_bits(images, noise: float, rng: np.random.Generator):
    if noise:
        images = [q + rng.normal(0, noise * 255, q.shape) for q in images]
    return tuple(np.clip(np.rint(q), 0, 255).astype(np.uint8) for q in images)


def particles(
    field: Field,
    density: float = 0.03,
    sigma: float = 0.675,
    gain: float = 0.0,
    unmatched: float = 0.0,
    noise: float = 0.0,
    lit: bool = False,
    hole: np.ndarray | None = None,
    seed: int = 3,
) -> tuple[np.ndarray, np.ndarray]:
    """Two uint8 images; particles per px, their standard deviation (px), spread of their gain, shares."""
    rng = np.random.default_rng(seed)
    n = int(density * (N + 2 * _PAD) ** 2)
    x, y = rng.uniform(-_PAD, N + _PAD, (2, n))
    light = rng.uniform(60, 220, n)
    if hole is not None:
        keep = ~hole[tuple(np.clip(np.rint(q), 0, N - 1).astype(int) for q in (y, x))]
        x, y, light = x[keep], y[keep], light[keep]
    u, v = field(x, y)
    x2, y2 = x + u, y + v
    lost = rng.random(len(x)) < unmatched
    x2[lost], y2[lost] = rng.uniform(-_PAD, N + _PAD, (2, lost.sum()))
    a = _render(x, y, light, sigma) + 8
    b = _render(x2, y2, light * np.exp(gain * rng.normal(size=len(x))), sigma) + 8
    return _eight_bits((a, other_camera(b) if lit else b), noise, rng)


def texture(field: Field, lit: bool = False, hole: np.ndarray | None = None, seed: int = 1):
    """Two uint8 images of white noise, read by cubic splines."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(0, 1, (N + 2 * _PAD, N + 2 * _PAD))
    y, x = np.mgrid[:N, :N].astype(float)
    x0, y0 = x.copy(), y.copy()
    for _ in range(60):
        u, v = field(x0, y0)
        x0, y0 = x - u, y - v

    def read(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        image = 118 + 95 * ndimage.map_coordinates(
            noise, [y + _PAD, x + _PAD], order=3, prefilter=False, mode="mirror"
        )
        if hole is None:
            return image
        return np.where(ndimage.map_coordinates(hole.astype(float), [y, x], order=1) > 0.5, 20, image)

    a, b = read(x, y), read(x0, y0)
    return _eight_bits((a, other_camera(b) if lit else b), 0, rng)
