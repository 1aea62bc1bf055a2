"""From light to grey levels: spots integrated over pixels, uneven light, noise, quantisation."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled

Array = NDArray[np.float64]
Image = NDArray[np.float32]


def splat(image: Image, X: Array, Y: Array, flux: Array, sigma: float) -> None:
    """Add Gaussian spots to an image, each integrated exactly over every pixel.

    With image (row, column); X, Y (n,), px; flux (n,); sigma, px.
    """
    _splat(image, X, Y, flux, sigma)


@compiled(fastmath=True)
def _splat(image: NDArray[np.float32], X: Array, Y: Array, flux: Array, sigma: float) -> None:
    height, width = image.shape
    reach = math.ceil(4.5 * sigma) + 1
    size = 2 * reach + 1
    wx, wy = np.empty(size), np.empty(size)
    scale = 1.0 / (math.sqrt(2.0) * sigma)
    for p in range(X.size):
        if not (-reach < X[p] < width + reach and -reach < Y[p] < height + reach and flux[p] > 0.0):
            continue
        left, top = round(X[p]) - reach, round(Y[p]) - reach
        ex = math.erf((left - 0.5 - X[p]) * scale)
        ey = math.erf((top - 0.5 - Y[p]) * scale)
        for i in range(size):
            fx = math.erf((left + i + 0.5 - X[p]) * scale)
            fy = math.erf((top + i + 0.5 - Y[p]) * scale)
            wx[i], wy[i] = 0.5 * (fx - ex), 0.5 * (fy - ey)
            ex, ey = fx, fy
        for i in range(max(0, -top), min(size, height - top)):
            part = flux[p] * wy[i]
            for j in range(max(0, -left), min(size, width - left)):
                image[top + i, left + j] += np.float32(part * wx[j])


def uneven(size: tuple[int, int], unevenness: float, seed: int) -> Image:
    """Light over an image: a slope and a fall towards the edges that differ from camera to camera.

    With size, px; returns (row, column): Factor with mean about 1..
    """
    rng = np.random.default_rng([seed, 3])
    angle = rng.uniform(0, 2 * np.pi)
    x = np.linspace(-1, 1, size[0], dtype=np.float32)
    y = np.linspace(-1, 1, size[1], dtype=np.float32)[:, None]
    slope = (np.cos(angle) * x + np.sin(angle) * y) / 2.8
    out: Image = (1.0 + unevenness * (slope - 0.15 * (x * x + y * y - 0.67))).astype(np.float32)
    return out


def expose(light: Image, read: float, shot: float, bits: int, rng: np.random.Generator) -> NDArray[Any]:
    """Turn light into the numbers of an image file.

    With light (row, column); returns (row, column): The image, clipped at full scale.
    """
    if read or shot:
        noise = rng.standard_normal(light.shape, np.float32)
    else:
        noise = np.zeros((1, 1), np.float32)
    if bits == 8:
        out: NDArray[Any] = np.empty(light.shape, np.uint8)
        _quantise(light, noise, read * read, shot, 1.0, 255.0, out)
    else:
        out = np.empty(light.shape, np.uint16)
        _quantise(light, noise, read * read, shot, 257.0, 65535.0, out)
    return out


@compiled(fastmath=True)
def _quantise(
    light: NDArray[np.float32],
    noise: NDArray[np.float32],
    variance: float,
    shot: float,
    scale: float,
    top: float,
    out: NDArray[Any],
) -> None:
    noisy = noise.size > 1
    for i in range(light.shape[0]):
        for j in range(light.shape[1]):
            value = light[i, j]
            if noisy:
                value += noise[i, j] * math.sqrt(variance + shot * max(value, np.float32(0.0)))
            out[i, j] = int(min(max(value * scale + 0.5, 0.0), top))
