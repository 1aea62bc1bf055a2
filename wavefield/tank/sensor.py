"""The camera's sensor: spots integrated over pixels, uneven light, noise and quantisation."""

import math

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled

Array = NDArray[np.float64]
Image = NDArray[np.float32]


@compiled(fastmath=True)
def splat(image: Image, X: Array, Y: Array, flux: Array, sigma: float) -> None:
    """Add n Gaussian spots at columns X and rows Y to an image in place, each integrated over every pixel.
    `flux` (n,) holds the total intensities of the spots; `sigma` is their standard deviation, px."""
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


def illumination(size: tuple[int, int], unevenness: float, seed: int) -> Image:
    """Return the relative illumination (row, column) of an image: a gradient in a random direction, dark
    edges.
    `size` is (width, height), px; `unevenness` is the relative difference of light across the image."""
    angle = np.random.default_rng([seed, 3]).uniform(0, 2 * np.pi)
    x = np.linspace(-1, 1, size[0], dtype=np.float32)
    y = np.linspace(-1, 1, size[1], dtype=np.float32)[:, None]
    slope = (np.cos(angle) * x + np.sin(angle) * y) / 2.8
    return np.asarray(1.0 + unevenness * (slope - 0.15 * (x * x + y * y - 0.67)), np.float32)


def expose(
    light: Image, read: float, shot: float, bits: int, rng: np.random.Generator
) -> NDArray[np.unsignedinteger]:
    """Return the image (row, column) that a camera stores, with noise, as integers of 8 or 16 `bits`.
    `light` and the rms read noise `read` are in grey levels from 0 to 255; `shot` is the shot-noise
    variance per grey level."""
    value = light.astype(np.float64)
    if read or shot:
        noise = rng.standard_normal(light.shape, np.float32)
        value += noise * np.sqrt(read * read + shot * np.maximum(value, 0.0))
    scale, top, kind = (1.0, 255.0, np.uint8) if bits == 8 else (257.0, 65535.0, np.uint16)
    return np.clip(value * scale + 0.5, 0.0, top).astype(kind)
