"""Particle images with exactly known displacement."""

import numpy as np
from scipy.special import erf


def render(x, y, brightness, shape, sigma=0.675):
    """Particles integrated over pixels, on a background of 8 grey levels."""
    h, w = shape
    reach = int(np.ceil(5 * sigma)) + 1
    inside = (x > -reach) & (x < w + reach) & (y > -reach) & (y < h + reach)
    x, y, brightness = x[inside], y[inside], brightness[inside]
    i, j = np.rint(x).astype(int), np.rint(y).astype(int)
    offset = np.arange(-reach, reach + 1)

    def share(place, pixel):
        d = (place - pixel)[:, None] - offset
        return 0.5 * (erf((d + 0.5) / (sigma * np.sqrt(2))) - erf((d - 0.5) / (sigma * np.sqrt(2))))

    light = (
        2 * np.pi * sigma**2 * brightness[:, None, None] * share(y, j)[:, :, None] * share(x, i)[:, None, :]
    )
    column = np.broadcast_to(i[:, None, None] + offset[None, None, :], light.shape)
    row = np.broadcast_to(j[:, None, None] + offset[None, :, None], light.shape)
    seen = (column >= 0) & (column < w) & (row >= 0) & (row < h)
    image = np.bincount(row[seen] * w + column[seen], light[seen], minlength=h * w)
    return image.reshape(h, w) + 8


def particle_pair(
    move,
    shape=(320, 360),
    density=0.03,
    sigma=0.675,
    gain=0.0,
    unmatched=0.0,
    noise=0.0,
    seed=1,
    as_type=np.uint8,
):
    """Two images; `move(x, y)` gives the displacement at the start of the path."""
    rng = np.random.default_rng(seed)
    h, w = shape
    pad = 80
    n = int(density * (h + 2 * pad) * (w + 2 * pad))
    x, y = rng.uniform(-pad, w + pad, n), rng.uniform(-pad, h + pad, n)
    bright = rng.uniform(60, 220, n)
    u, v = move(x, y)
    x2, y2 = x + u, y + v
    lost = rng.random(n) < unmatched
    x2[lost], y2[lost] = rng.uniform(-pad, w + pad, lost.sum()), rng.uniform(-pad, h + pad, lost.sum())
    a = render(x, y, bright, shape, sigma)
    b = render(x2, y2, bright * np.exp(gain * rng.normal(size=n)), shape, sigma)
    a, b = (q + rng.normal(0, noise * 255, shape) if noise else q for q in (a, b))
    if as_type is np.uint8:
        return tuple(np.clip(np.rint(q), 0, 255).astype(np.uint8) for q in (a, b))
    return a.astype(as_type), b.astype(as_type)


def wave(amplitude, wavelength):
    """A displacement field with both components waving, gradient 2 pi amplitude / wavelength."""
    k = 2 * np.pi / wavelength

    def move(x, y):
        return amplitude * np.sin(k * y) + 0 * x, amplitude * np.sin(k * x) + 0 * y

    return move


def uniform(u, v):
    """The same displacement everywhere."""
    return lambda x, y: (np.full_like(x, u), np.full_like(x, v))


def truth(d, move):
    """True u, v at the block centres of a displacement."""
    return move(*np.meshgrid(d.x, d.y))


def interior(d, shape, margin=40):
    """Blocks at least `margin` px from the border."""
    x, y = np.meshgrid(d.x, d.y)
    return (x > margin) & (x < shape[1] - 1 - margin) & (y > margin) & (y < shape[0] - 1 - margin)
