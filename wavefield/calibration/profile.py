"""Profile of a string across its direction: a box convolved with a Gaussian, averaged over a pixel."""

import math

from wavefield.compiled import compiled
from wavefield.rig.lens import Array

PLACES = 64  # distances from a string's middle at which its profile is tabulated


@compiled()
def profile_of(u: float, s: float, out: Array) -> float:
    """Profile of a string averaged over a pixel, its slope from place to place, and its derivative to u.
    Fills out (places, 3), which all pixels of a crossing share; returns the inverse of their distance, 1/px.
    """
    # six standard deviations beyond the box the profile is zero
    step = (math.sqrt(max(u, 0.0)) + 6.2 * s + 0.4) / (PLACES - 1)
    for k in range(PLACES - 1):
        d = k * step
        f0, g0, u0 = _line(d, u, s)
        # the mean over a pixel by three points of Gauss-Legendre along one axis
        f1, g1, u1 = _line(d + 0.3872983346207417, u, s)
        f2, g2, u2 = _line(d - 0.3872983346207417, u, s)
        out[k, 0] = (8.0 * f0 + 5.0 * (f1 + f2)) / 18.0
        out[k, 1] = (8.0 * g0 + 5.0 * (g1 + g2)) / 18.0 * step
        out[k, 2] = (8.0 * u0 + 5.0 * (u1 + u2)) / 18.0
    out[PLACES - 1] = 0.0
    return 1.0 / step


@compiled(inline="always")
def profile_at(profile: Array, inverse: float, d: float) -> tuple[float, float, float]:
    """Profile and derivatives at a distance d: a cubic through values and slopes, its slope, a line."""
    x = abs(d) * inverse
    if x >= PLACES - 1:
        return 0.0, 0.0, 0.0
    k = int(x)
    t = x - k
    f, g, more, after = profile[k, 0], profile[k, 1], profile[k + 1, 0], profile[k + 1, 1]
    rise = more - f
    c3 = g + after - 2.0 * rise
    c2 = rise - g - c3
    slope = (g + t * (2.0 * c2 + 3.0 * c3 * t)) * inverse
    return (
        f + t * (g + t * (c2 + t * c3)),
        math.copysign(slope, slope * d),
        profile[k, 2] + t * (profile[k + 1, 2] - profile[k, 2]),
    )


@compiled(inline="always")
def _above(x: float, density: float) -> float:
    """Fraction of a normal distribution above x, to 1e-7, from its density at x.
    Abramowitz and Stegun 26.2.17: a third of the time of an error function, since the density is given.
    """
    t = 1.0 / (1.0 + 0.2316419 * abs(x))
    out = (
        density
        * t
        * (0.319381530 + t * (-0.356563782 + t * (1.781477937 + t * (-1.821255978 + t * 1.330274429))))
    )
    return 1.0 - out if x < 0.0 else out


@compiled(inline="always")
def _line(d: float, u: float, s: float) -> tuple[float, float, float]:
    """Profile of a string of unit flux at d, px, and its derivatives with respect to d and u.
    A box of half width sqrt(u) convolved with a Gaussian of standard deviation s.
    """
    if u > 0.1 * s * s:
        h = math.sqrt(u)
        p, m = (d + h) / s, (d - h) / s
        gp = math.exp(-0.5 * p * p) * 0.3989422804014327
        gm = math.exp(-0.5 * m * m) * 0.3989422804014327
        f = (_above(m, gm) - _above(p, gp)) / (2.0 * h)
        return f, (gp - gm) / (2.0 * h * s), ((gp + gm) / (2.0 * h * s) - f / h) / (2.0 * h)
    # small or negative u: a Gaussian of the same variance, which joins smoothly
    v = s * s + u / 3.0
    f = math.exp(-0.5 * d * d / v) * 0.3989422804014327 / math.sqrt(v)
    return f, -d * f / v, f * (d * d / v - 1.0) / (6.0 * v)
