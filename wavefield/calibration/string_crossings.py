"""Crossings of strings to a few hundredths of a pixel."""

import math
from dataclasses import dataclass

import numpy as np

from wavefield.calibration.points import Image, Mask
from wavefield.compiled import compiled
from wavefield.rig.lens import Array
from wavefield.robust import PER_MEDIAN

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


Pair = tuple[float, float]

# order of the parameters of one crossing
CX, CY, ANGLE1, ANGLE2, WIDTH1, WIDTH2, FLUX1, FLUX2, GROUND, SLOPE_X, SLOPE_Y, OVERLAP = range(12)
COUNT = 12
LINEAR = 6  # the parameters from FLUX1 on enter linearly
TOLERANCE = 2e-4  # px: a fit ends when the centre moves less
MAX_ARM = 18.0  # px: of a string on either side of a crossing


@dataclass(frozen=True)
class Crossings:
    """Crossings fitted in one image; arrays over n crossings."""

    pixel: Array  # (n, 2): Position (X, Y), px
    std: Array  # (n,): Standard uncertainty per axis, px
    angle: Array  # (n, 2): Directions of the two strings in the image, radians
    sigma: Array  # (n, 2): Standard deviation of the two profiles, px
    flux: Array  # (n, 2): Brightness of the two strings, integrated across them, grey px
    arms: Array  # (n, 4): Brightness of each of the four arms relative to its string's
    misfit: Array  # (n,): Residual relative to the noise; about 1 where the model holds
    parameters: Array  # (n, 12): All parameters, to start a further fit from
    # (n, 4): Mean grey and mean squared residual next to the strings, and the same on the strings
    noise: Array

    def only(self, keep: Mask) -> "Crossings":
        """Some of the crossings."""
        return Crossings(**{name: value[keep] for name, value in vars(self).items()})


@compiled()
def _cholesky_solve(a: Array, b: Array, n: int) -> bool:
    """Solve a x = b for the leading n x n block; a is overwritten, x replaces b. False if not positive."""
    for j in range(n):
        t = a[j, j]
        for k in range(j):
            t -= a[j, k] * a[j, k]
        if not t > 0.0:
            return False
        t = math.sqrt(t)
        a[j, j] = t
        for i in range(j + 1, n):
            r = a[i, j]
            for k in range(j):
                r -= a[i, k] * a[j, k]
            a[i, j] = r / t
    for i in range(n):
        r = b[i]
        for k in range(i):
            r -= a[i, k] * b[k]
        b[i] = r / a[i, i]
    for i in range(n - 1, -1, -1):
        r = b[i]
        for k in range(i + 1, n):
            r -= a[k, i] * b[k]
        b[i] = r / a[i, i]
    return True


@compiled()
def _pixels_near(image: Image, start: Array, arm1: Array, arm2: Array, band: float) -> Array:
    """Pixels of the parallelogram of the arms that are close to either string: x, y and value, (3, n)."""
    rows, columns = image.shape
    det = arm1[0] * arm2[1] - arm1[1] * arm2[0]
    wide, tall = abs(arm1[0]) + abs(arm2[0]), abs(arm1[1]) + abs(arm2[1])
    x0, x1 = max(0, int(start[CX] - wide)), min(columns - 1, int(start[CX] + wide) + 1)
    y0, y1 = max(0, int(start[CY] - tall)), min(rows - 1, int(start[CY] + tall) + 1)
    c1, s1 = math.cos(start[ANGLE1]), math.sin(start[ANGLE1])
    c2, s2 = math.cos(start[ANGLE2]), math.sin(start[ANGLE2])
    out = np.empty((3, max(0, x1 - x0 + 1) * max(0, y1 - y0 + 1)))
    n = 0
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            dx, dy = x - start[CX], y - start[CY]
            if abs((dx * arm2[1] - dy * arm2[0]) / det) > 1.0:
                continue
            if abs((dy * arm1[0] - dx * arm1[1]) / det) > 1.0:
                continue
            if abs(-s1 * dx + c1 * dy) < band or abs(-s2 * dx + c2 * dy) < band:
                out[0, n], out[1, n], out[2, n] = x, y, image[y, x]
                n += 1
    return out[:, :n].copy()


@compiled(error_model="numpy")
def _rows(
    pixels: Array, p: Array, blur: float, variance: Pair, spread: float, free: int, misses: Array, rows: Array
) -> float:
    """Weighted equations of all pixels for the first `free` parameters, linear ones first; returns the count.
    misses (2, n): residuals, in grey and in standard deviations; rows (13, n): derivatives, residuals last.
    """
    profile1, profile2 = np.empty((PLACES, 3)), np.empty((PLACES, 3))
    inverse1, inverse2 = profile_of(p[WIDTH1], blur, profile1), profile_of(p[WIDTH2], blur, profile2)
    c1, s1, c2, s2 = math.cos(p[ANGLE1]), math.sin(p[ANGLE1]), math.cos(p[ANGLE2]), math.sin(p[ANGLE2])
    count = 0.0
    for k in range(pixels.shape[1]):
        dx, dy = pixels[0, k] - p[CX], pixels[1, k] - p[CY]
        d1, d2 = -s1 * dx + c1 * dy, -s2 * dx + c2 * dy
        f1, g1, u1 = profile_at(profile1, inverse1, d1)
        f2, g2, u2 = profile_at(profile2, inverse2, d2)
        model = (
            p[GROUND]
            + p[SLOPE_X] * dx
            + p[SLOPE_Y] * dy
            + p[FLUX1] * f1
            + p[FLUX2] * f2
            + p[OVERLAP] * f1 * f2
        )
        r = pixels[2, k] - model
        w = 1.0 / math.sqrt(variance[0] + variance[1] * max(model, 0.0))
        misses[0, k], misses[1, k] = r, abs(r) * w
        t = min(misses[1, k] / spread, 1.0)  # biweight: residuals beyond six deviations have no weight
        count += t < 1.0
        w *= 1.0 - t * t
        rows[0, k], rows[1, k], rows[2, k] = w * f1, w * f2, w
        rows[3, k], rows[4, k], rows[5, k] = w * dx, w * dy, w * f1 * f2
        rows[COUNT, k] = w * r
        if free == COUNT:
            m1 = w * (p[FLUX1] + p[OVERLAP] * f2)  # d model / d f1
            m2 = w * (p[FLUX2] + p[OVERLAP] * f1)
            rows[6, k] = m1 * g1 * s1 + m2 * g2 * s2 - w * p[SLOPE_X]
            rows[7, k] = -m1 * g1 * c1 - m2 * g2 * c2 - w * p[SLOPE_Y]
            rows[8, k] = -m1 * g1 * (c1 * dx + s1 * dy)
            rows[9, k] = -m2 * g2 * (c2 * dx + s2 * dy)
            rows[10, k] = m1 * u1
            rows[11, k] = m2 * u2
    return count


@compiled(fastmath={"contract", "reassoc"})
def _product(one: Array, other: Array) -> float:
    total = 0.0
    for k in range(len(one)):
        total += one[k] * other[k]
    return total


@compiled()
def _equations(rows: Array, free: int, a: Array, b: Array) -> float:
    """Normal equations of the first `free` parameters (lower triangle); returns the misfit."""
    for i in range(free):
        b[i] = _product(rows[i], rows[COUNT])
        for m in range(i + 1):
            a[i, m] = _product(rows[i], rows[m])
    return _product(rows[COUNT], rows[COUNT])


@compiled()
def _damped(a: Array, by: float, least: float, n: int, out: Array) -> None:
    """Copy the lower triangle of the leading n x n block, its diagonal made larger."""
    for i in range(n):
        for m in range(i + 1):
            out[i, m] = a[i, m]
        out[i, i] *= 1.0 + by
        out[i, i] += least


@compiled()
def _advance(p: Array, steps: Array, blur: float) -> float:
    """Add the steps (linear parameters first) within limits; returns how far the centre moved at most, px."""
    largest = 0.0
    for i in range(len(steps)):
        step = steps[i]
        q = i + LINEAR if i < LINEAR else i - LINEAR
        if q in (CX, CY):
            step = min(max(step, -1.0), 1.0)
            largest = max(largest, abs(step))
        elif q in (ANGLE1, ANGLE2):
            step = min(max(step, -0.1), 0.1)
        elif q in (WIDTH1, WIDTH2):
            limit = max(0.5 * abs(p[q]), blur * blur)
            step = min(max(step, -limit), limit)
        p[q] += step
    for q in (WIDTH1, WIDTH2):
        p[q] = min(max(p[q], -1.8 * blur * blur), 60.0)
    return largest


@compiled()
def _centre_variance(a: Array, chi: float, out: Array) -> bool:
    """Variance of the centre along x and y, px^2; False where the equations have no solution."""
    damped, b = np.zeros((COUNT, COUNT)), np.zeros(COUNT)
    for axis in range(2):
        b[:] = 0.0
        b[LINEAR + axis] = 1.0
        _damped(a, 1e-9, 0.0, COUNT, damped)
        if not _cholesky_solve(damped, b, COUNT):
            return False
        out[axis] = b[LINEAR + axis] * max(chi, 1e-3) ** 2
    return True


@compiled()
def _evaluate(
    pixels: Array,
    p: Array,
    angles: Pair,
    blur: float,
    misses: Array,
    spread: float,
    arms: Array,
    noise: Array,
) -> None:
    """Brightness of each arm relative to its string, and noise of ground and strings."""
    c1, s1, c2, s2 = math.cos(angles[0]), math.sin(angles[0]), math.cos(angles[1]), math.sin(angles[1])
    v1, v2 = math.sqrt(blur * blur + p[WIDTH1] / 3.0), math.sqrt(blur * blur + p[WIDTH2] / 3.0)
    profile1, profile2 = np.empty((PLACES, 3)), np.empty((PLACES, 3))
    inverse1, inverse2 = profile_of(p[WIDTH1], blur, profile1), profile_of(p[WIDTH2], blur, profile2)
    found = np.zeros(4)
    noise[:] = 0.0
    n_ground, n_string = 0, 0
    arms[:] = 0.0
    for k in range(pixels.shape[1]):
        dx, dy, value, residual = pixels[0, k] - p[CX], pixels[1, k] - p[CY], pixels[2, k], misses[0, k]
        d1, d2 = -s1 * dx + c1 * dy, -s2 * dx + c2 * dy
        f1, _, _ = profile_at(profile1, inverse1, d1)
        f2, _, _ = profile_at(profile2, inverse2, d2)
        above = value - p[GROUND] - p[SLOPE_X] * dx - p[SLOPE_Y] * dy
        if abs(d1) < v1 and abs(d2) > 2.5 * v2:
            arm = 0 if c1 * dx + s1 * dy > 0 else 1
            arms[arm] += above / (p[FLUX1] * f1)
            found[arm] += 1
        if abs(d2) < v2 and abs(d1) > 2.5 * v1:
            arm = 2 if c2 * dx + s2 * dy > 0 else 3
            arms[arm] += above / (p[FLUX2] * f2)
            found[arm] += 1
        if not misses[1, k] < spread:
            continue
        if abs(d1) > 2.5 * v1 and abs(d2) > 2.5 * v2:
            noise[0] += value - residual
            noise[1] += residual**2
            n_ground += 1
        elif (abs(d1) < v1) != (abs(d2) < v2):
            noise[2] += value - residual
            noise[3] += residual**2
            n_string += 1
    for i in range(4):
        arms[i] = arms[i] / found[i] if found[i] >= 3 else 0.0
    noise[:2] /= max(n_ground, 1)
    noise[2:] /= max(n_string, 1)


@compiled()
def _fit_one(
    pixels: Array,
    blur: float,
    variance: Pair,
    p: Array,
    covariance: Array,
    arms: Array,
    noise: Array,
    close: float,
) -> float:
    """Fit one crossing, p in place; returns the misfit over the noise, or -1 if nothing can be fitted."""
    n = pixels.shape[1]
    if n < 45:
        return -1.0
    misses, rows = np.empty((2, n)), np.empty((COUNT + 1, n))
    a, damped, b = np.zeros((COUNT, COUNT)), np.zeros((COUNT, COUNT)), np.zeros(COUNT)
    spread, chi = 1e30, 0.0
    angles = (p[ANGLE1], p[ANGLE2])
    for iteration in range(16):
        free = LINEAR if iteration == 0 else COUNT
        angles = (p[ANGLE1], p[ANGLE2])
        count = _rows(pixels, p, blur, variance, spread, free, misses, rows)
        if count < 30:
            return -1.0
        total = _equations(rows, free, a, b)
        chi = math.sqrt(total / max(count - COUNT, 1.0))
        _damped(a, 1e-9 if iteration == 0 else 1e-3 * 0.2**iteration + 1e-9, 1e-12, free, damped)
        if not _cholesky_solve(damped, b, free):
            return -1.0
        moved = _advance(p, b[:free], blur)
        if iteration >= 2:
            spread = 6.0 * max(PER_MEDIAN * np.median(misses[1]), 1e-3)
        if iteration > 3 and moved < close:
            break
    if not _centre_variance(a, chi, covariance):
        return -1.0
    _evaluate(pixels, p, angles, blur, misses, spread, arms, noise)
    return chi


@compiled()
def _fit_all(
    image: Image, arms: Array, blur: float, band: Array, variance: Pair, close: float, p: Array, out: Array
) -> None:
    """Fit crossings with arms (n, 2, 2): parameters p (n, 12) in place, results (n, 11) as sliced below."""
    for k in range(len(p)):
        pixels = _pixels_near(image, p[k], arms[k, 0], arms[k, 1], band[k])
        covariance, brightness, noise = out[k, :2], out[k, 2:6], out[k, 6:10]
        out[k, 10] = _fit_one(pixels, blur, variance, p[k], covariance, brightness, noise, close)


def start_parameters(pixel: Array, slopes: Array, sigma: float, blur: float) -> Array:
    """Parameters (n, 12) to begin a fit with, all lengths in px; the first, linear step fits the rest."""
    p = np.zeros((len(pixel), COUNT))
    p[:, CX], p[:, CY] = pixel.T
    p[:, ANGLE1] = np.arctan2(slopes[:, 0, 1], slopes[:, 0, 0])
    p[:, ANGLE2] = np.arctan2(slopes[:, 1, 1], slopes[:, 1, 0])
    p[:, WIDTH1] = p[:, WIDTH2] = 3.0 * (sigma**2 - blur**2)
    return p


def fit_crossings(
    image: Image,
    start: Array,
    slopes: Array,
    blur: float,
    noise: tuple[float, float] = (1.0, 0.0),
    tolerance: float = TOLERANCE,
) -> Crossings:
    """Fit two crossing strings, boxes convolved with a Gaussian (blur, px), around each of start (n, 12).
    Damped Gauss-Newton with biweights at six robust deviations.
    """
    parameters = np.array(start, float)
    length = np.hypot(slopes[..., 0], slopes[..., 1])
    arms = slopes * (np.minimum(0.45, MAX_ARM / np.maximum(length, 1e-9)))[..., None]
    variance = blur**2 + start[:, WIDTH1 : WIDTH2 + 1].max(1) / 3.0
    band = 3.0 * np.sqrt(np.maximum(variance, 0.25)) + 1.5
    results = np.zeros((len(start), 11))
    results[:, :2], results[:, 10] = np.inf, -1.0
    pixels = np.ascontiguousarray(image, np.float32)
    grey_variance = float(noise[0]), float(noise[1])
    _fit_all(pixels, arms, float(blur), band, grey_variance, float(tolerance), parameters, results)
    covariance, misfit = results[:, :2], results[:, 10]
    good = (misfit >= 0) & np.isfinite(parameters).all(1) & (covariance > 0).all(1)
    # the biweight makes Gaussian residuals smaller by a factor 1.08 than it makes the estimate sharper
    std = np.where(good, 1.08 * np.sqrt(np.where(good, covariance.sum(1), 0) / 2), np.inf)
    return Crossings(
        pixel=parameters[:, :2],
        std=std,
        angle=parameters[:, ANGLE1 : ANGLE2 + 1],
        sigma=np.sqrt(np.maximum(blur**2 + parameters[:, WIDTH1 : WIDTH2 + 1] / 3.0, 1e-6)),
        flux=parameters[:, FLUX1 : FLUX2 + 1],
        arms=results[:, 2:6],
        misfit=misfit,
        parameters=parameters,
        noise=results[:, 6:10],
    )
