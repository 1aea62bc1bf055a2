"""Slopes of a field at the edges of its lattice, which a cosine basis cannot represent."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.matching.cosines import cosines
from wavefield.matching.prior import Prior

F = np.float32
Float = NDArray[Any]
Profiles = tuple[Float, Float]
Slopes = tuple[Float, Float, Float, Float]

EDGE_REACH = 6.0  # blocks: decay length of the smooth field, and width over which slopes are fitted
ALONG_EDGE_SIGMA = 3.0  # blocks: smoothing of the slopes along the edge


class Edge:
    """Smooth fields on a lattice (ny, nx) that have given slopes at its edges."""

    def __init__(self, shape: tuple[int, int]) -> None:
        width = int(EDGE_REACH)
        t = np.arange(width, dtype=np.float32) - F((width - 1) / 2)
        self.slope = t / (t * t).sum()
        self.width = width
        along_y, along_x = (
            (EDGE_REACH * np.exp((np.arange(n) + 0.5 - n) / EDGE_REACH)).astype(np.float32) for n in shape
        )
        self.profiles: Profiles = along_y, along_x
        self.smooth_y, self.smooth_x = (_smoother(n) for n in shape)

    def slopes(self, field: Float) -> Slopes:
        """Slopes of fields (c, ny, nx) at the first, last column (c, ny) and the first, last row (c, nx)."""
        width, (ny, nx) = self.width, field.shape[-2:]
        left = field[..., :width] @ self.slope @ self.smooth_y
        right = field[..., nx - width :] @ self.slope @ self.smooth_y
        # slopes of the rows are fitted after the field of the columns' slopes is subtracted
        out = _along_x(left, right, self.profiles[1])
        first, last = field[:, :width] - out[:, :width], field[:, ny - width :] - out[:, ny - width :]
        low = np.einsum("cyx,y->cx", first, self.slope) @ self.smooth_x
        high = np.einsum("cyx,y->cx", last, self.slope) @ self.smooth_x
        return left, right, low, high

    def responses(self, kx: Float, ky: Float) -> tuple[Float, Float]:
        """Squared response of the slopes at columns' edges and at rows' to waves kx (nx,), ky (ny, 1)."""
        t = np.arange(self.width)
        fit_x, fit_y = (np.square(np.abs(np.exp(1j * k.reshape(-1, 1) * t) @ self.slope)) for k in (kx, ky))
        along_x, along_y = (np.exp(-np.square(ALONG_EDGE_SIGMA * k)) for k in (kx, ky))
        return fit_x * along_y, fit_y[:, None] * along_x

    def spread(self, across_x: Float, across_y: Float) -> Float:
        """Variance (c, ny, nx) of the smooth field by those of slopes at columns' and at rows' edges (c,)."""
        on_y, on_x = (np.square(profile) + np.square(profile[::-1]) for profile in self.profiles)
        return np.asarray(across_x[:, None, None] * on_x + across_y[:, None, None] * on_y[:, None])

    def field(self, slopes: Slopes, profiles: Profiles | None = None) -> Float:
        """The smooth field (c, ny, nx) with these slopes, or its part with the given profiles."""
        along_y, along_x = profiles or self.profiles
        left, right, low, high = slopes
        out = _along_x(left, right, along_x)
        out += high[:, None] * along_y[:, None]
        out -= low[:, None] * along_y[::-1, None]
        return out

    def truncated_profiles(self, counts: tuple[int, int], gains: Profiles) -> Profiles:
        """Part of the profiles that the first `counts` cosines along y and x do not represent, for `field`.
        `gains` (ny,) and (nx,) multiply the cosines.
        """
        out = []
        for profile, count, gain in zip(self.profiles, counts, gains, strict=True):
            modes = cosines(profile.size, profile.size)
            waves = modes @ profile * gain
            waves[:count] = 0.0
            out.append((waves @ modes).astype(np.float32))
        return out[0], out[1]


def kept_slopes(prior: Prior, edge: Edge, kx: Float, ky: Float) -> tuple[Float, Float]:
    """Fraction of slopes at columns' and at rows' edges that is kept, (2, c), and variance of noise in it.
    All is kept where waves exceed noise: the rest of a long wave's slope would ring far into the field.
    """
    spectrum = prior.spectrum(kx, ky)
    noise = 1.0 / (prior.footprint(kx, ky) ** 2 * prior.information)
    responses = edge.responses(kx, ky)
    of_waves = np.array([np.mean(spectrum * one, axis=(1, 2)) for one in responses])
    of_noise = np.array([np.full(len(spectrum), np.mean(noise * one)) for one in responses])
    kept = np.minimum(of_waves / of_noise, 1.0)
    lost = of_noise / (of_waves + of_noise)  # what the cosines do not correct, where they are as free
    return kept, np.square(kept * lost) * of_noise


def _along_x(left: Float, right: Float, profile: Float) -> Float:
    out: Float = right[..., None] * profile - left[..., None] * profile[::-1]
    return out


def _smoother(n: int) -> Float:
    modes = cosines(n, n)
    gain = np.exp(-0.5 * np.square(ALONG_EDGE_SIGMA * np.pi * np.arange(n) / n))
    out: Float = ((modes.T * gain) @ modes).astype(np.float32)
    return out


def edge_slopes(field: Float) -> Float:
    """A smooth field (c, ny, nx) with the edge slopes of a given one.

    Parameters
    ----------
    field : ndarray, (c, ny, nx)
        Without holes.

    Returns
    -------
    ndarray of float32, (c, ny, nx)
    """
    field = np.asarray(field, np.float32)
    edge = Edge((field.shape[1], field.shape[2]))
    return edge.field(edge.slopes(field))
