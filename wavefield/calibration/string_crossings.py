"""Fit crossings of two strings to a few hundredths of a pixel.

The model of an image around a crossing is a plane background plus two straight strings. The brightness across
a string is a box convolved with a Gaussian, which stands for the blur by lens and pixel. An arm is a string
on one side of the crossing. The flux of a string is its brightness integrated across it.
"""

import math
from dataclasses import dataclass

import numpy as np

from wavefield.calibration.points import Image, Mask
from wavefield.compiled import compiled
from wavefield.rig.lens import Array
from wavefield.robust import PER_MEDIAN

Pair = tuple[float, float]


@compiled(inline="always")
def gaussian(p: float) -> Pair:
    """Return the standard normal density at p, and its integral from 0 to p.
    The error is below 1e-7 (Abramowitz and Stegun 1964, 26.2.17); `math.erf` takes twice as long."""
    density = math.exp(-0.5 * p * p) * 0.3989422804014327
    t = 1.0 / (1.0 + 0.2316419 * abs(p))
    series = 0.31938153 + t * (-0.356563782 + t * (1.781477937 + t * (-1.821255978 + t * 1.330274429)))
    return density, math.copysign(0.5 - density * t * series, p)


@compiled(inline="always")
def profile(d: float, u: float, s: float) -> tuple[float, float, float]:
    """Return the brightness f at a distance d, px, from the axis of a string, and df/dd, df/du.
    The profile is a box of half width sqrt(u), px, with unit integral, blurred by a Gaussian of std s, px."""
    h = math.sqrt(max(u, 0.0))
    if abs(d) > h + 6.0 * s:
        return 0.0, 0.0, 0.0
    if u > 0.1 * s * s:
        (gp, p), (gm, m) = gaussian((d + h) / s), gaussian((d - h) / s)
        f = (p - m) / (2.0 * h)
        return f, (gp - gm) / (2.0 * h * s), ((gp + gm) / (2.0 * h * s) - f / h) / (2.0 * h)
    # for small or negative u, a Gaussian of the same variance continues the profile smoothly
    v = s * s + u / 3.0
    f = math.exp(-0.5 * d * d / v) * 0.3989422804014327 / math.sqrt(v)
    return f, -d * f / v, f * (d * d / v - 1.0) / (6.0 * v)


# order of the parameters of one crossing; the model is linear in those from FLUX1 on
CX, CY, ANGLE1, ANGLE2, WIDTH1, WIDTH2, FLUX1, FLUX2, GROUND, SLOPE_X, SLOPE_Y, OVERLAP, COUNT = range(13)
LINEAR = COUNT - FLUX1
TOLERANCE = 2e-4  # px: a fit ends when the centre moves less, a tenth of the error in the best images
MAX_ARM = 18.0  # px: length of an arm; tuned on simulated string grids


@dataclass(frozen=True)
class Crossings:
    """Results of the fits of n crossings of two strings in one image."""

    pixel: Array  # (n, 2): Position (X, Y), px
    std: Array  # (n,): Standard uncertainty per axis, px
    angle: Array  # (n, 2): Directions of the two strings in the image, radians
    sigma: Array  # (n, 2): Standard deviation of the two profiles, px
    flux: Array  # (n, 2): Brightness of the two strings, integrated across them, grey px
    arms: Array  # (n, 4): Brightness of each arm, relative to its string's
    misfit: Array  # (n,): Residual over noise, about 1 where the model holds; -1 if the fit failed
    parameters: Array  # (n, 12): All parameters, from which a further fit can start
    noise: Array  # (n, 4): Mean grey and mean squared residual, of the background and of the strings

    def only(self, keep: Mask) -> "Crossings":
        """Return the crossings for which the mask `keep` (n,) is true."""
        return Crossings(**{name: value[keep] for name, value in vars(self).items()})


@compiled()
def _pixels_near(image: Image, start: Array, arm1: Array, arm2: Array, band: float) -> Array:
    """Return columns, rows and grey values, (3, n), of the pixels near a crossing with parameters `start`.
    They are in the parallelogram of the vectors `arm1` and `arm2` (2,) and within `band`, px, of a string."""
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
    """Write to rows (13, n), for each pixel, weighted derivatives of the model of a crossing by its first
    `free` parameters (of the 12 in `p`), and last the weighted residual. `pixels` (3, n) holds x, y and grey
    level. misses (2, n) receives residuals in grey levels and in standard deviations. Residuals over `spread`
    standard deviations have weight 0. Return the number of pixels with a weight above 0."""
    c1, s1, c2, s2 = math.cos(p[ANGLE1]), math.sin(p[ANGLE1]), math.cos(p[ANGLE2]), math.sin(p[ANGLE2])
    count = 0.0
    for k in range(pixels.shape[1]):
        dx, dy = pixels[0, k] - p[CX], pixels[1, k] - p[CY]
        d1, d2 = -s1 * dx + c1 * dy, -s2 * dx + c2 * dy
        f1, g1, u1 = profile(d1, p[WIDTH1], blur)
        f2, g2, u2 = profile(d2, p[WIDTH2], blur)
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
        t = min(misses[1, k] / spread, 1.0)  # Tukey's biweight: no weight beyond six standard deviations
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


@compiled()
def _advance(p: Array, steps: Array, blur: float) -> float:
    """Add `steps` (linear parameters first) to the parameters p (12,), in place, each within a limit.
    Returns how far the centre has moved, px: the larger of the steps along x and y."""
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


@compiled(error_model="numpy")
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
    """Write the brightness of the arms to arms (4,), and four measures of noise to noise (4,).
    `Crossings` describes both arrays. p (12,) are the fitted parameters, `misses` (2, n) the residuals of
    `pixels` (3, n) in grey levels and in standard deviations, `angles` the directions of the strings, rad."""
    c1, s1, c2, s2 = math.cos(angles[0]), math.sin(angles[0]), math.cos(angles[1]), math.sin(angles[1])
    v1, v2 = math.sqrt(blur * blur + p[WIDTH1] / 3.0), math.sqrt(blur * blur + p[WIDTH2] / 3.0)
    found = np.zeros(4)
    noise[:] = 0.0
    n_ground, n_string = 0, 0
    arms[:] = 0.0
    for k in range(pixels.shape[1]):
        dx, dy, value, residual = pixels[0, k] - p[CX], pixels[1, k] - p[CY], pixels[2, k], misses[0, k]
        d1, d2 = -s1 * dx + c1 * dy, -s2 * dx + c2 * dy
        f1, _, _ = profile(d1, p[WIDTH1], blur)
        f2, _, _ = profile(d2, p[WIDTH2], blur)
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
) -> float:
    """Fit one crossing by damped Gauss-Newton steps; return the ratio of residual to noise, -1 if it fails.
    Changed in place: the parameters p (12,); `covariance` (2,), the variances of x and y, px^2; `arms` (4,),
    relative brightnesses; `noise` (4,), mean grey and mean squared residual of the background, then of the
    strings."""
    n = pixels.shape[1]
    if n < 45:
        return -1.0
    misses, rows = np.empty((2, n)), np.empty((COUNT + 1, n))
    spread, chi = 1e30, 0.0
    angles, normal = (p[ANGLE1], p[ANGLE2]), np.zeros((COUNT, COUNT))
    for iteration in range(16):
        free = LINEAR if iteration == 0 else COUNT
        angles = (p[ANGLE1], p[ANGLE2])
        count = _rows(pixels, p, blur, variance, spread, free, misses, rows)
        if count < 30:
            return -1.0
        chi = math.sqrt(rows[COUNT] @ rows[COUNT] / max(count - COUNT, 1.0))
        normal = rows[:free] @ rows[:free].T
        damping = 1e-9 if iteration == 0 else 1e-3 * 0.2**iteration + 1e-9
        damped = normal + np.diag(damping * np.diag(normal) + 1e-12)
        if not np.isfinite(damped).all():
            return -1.0
        moved = _advance(p, np.linalg.solve(damped, rows[:free] @ rows[COUNT]), blur)
        if iteration >= 2:
            spread = 6.0 * max(PER_MEDIAN * np.median(misses[1]), 1e-3)
        if iteration > 3 and moved < TOLERANCE:
            break
    inverse = np.linalg.inv(normal + np.diag(1e-9 * np.diag(normal) + 1e-12))
    for axis in range(2):
        covariance[axis] = inverse[LINEAR + axis, LINEAR + axis] * max(chi, 1e-3) ** 2
    _evaluate(pixels, p, angles, blur, misses, spread, arms, noise)
    return chi if np.isfinite(arms).all() else -1.0  # arms are not finite if a string has no brightness


@compiled()
def _fit_all(
    image: Image, arms: Array, blur: float, band: Array, variance: Pair, p: Array, out: Array
) -> None:
    """Fit all crossings: write the parameters to p (n, 12) and further results to out (n, 11).
    `arms` (n, 2, 2) and `band` (n,), px, bound the pixels of each crossing. The columns of `out` are two
    variances, of x and y, px^2; the brightness of four arms; four values of noise as in `Crossings`; and the
    ratio of residual to noise."""
    for k in range(len(p)):
        pixels = _pixels_near(image, p[k], arms[k, 0], arms[k, 1], band[k])
        covariance, brightness, noise = out[k, :2], out[k, 2:6], out[k, 6:10]
        out[k, 10] = _fit_one(pixels, blur, variance, p[k], covariance, brightness, noise)


def start_parameters(pixel: Array, slopes: Array, sigma: float, blur: float) -> Array:
    """Return start values (n, 12) of centres, angles and widths for `fit_crossings`; others are zero.
    `slopes` (n, 2, 2) are steps in the image along the two strings, px. `sigma` is the standard deviation of
    a string's profile, `blur` that of the blur by lens and pixel, px."""
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
) -> Crossings:
    """Fit all crossings from the parameters `start` (n, 12) with Tukey's biweight.
    `slopes` (n, 2, 2) are the steps in the image from each crossing to the next along the two strings, px;
    `blur`, px, is the standard deviation of the blur; `noise` is the variance of a pixel at zero grey, and
    its increase per grey level."""
    parameters = np.array(start, float)
    length = np.hypot(slopes[..., 0], slopes[..., 1])
    arms = slopes * (np.minimum(0.45, MAX_ARM / np.maximum(length, 1e-9)))[..., None]
    variance = blur**2 + start[:, WIDTH1 : WIDTH2 + 1].max(1) / 3.0
    band = 3.0 * np.sqrt(np.maximum(variance, 0.25)) + 1.5
    results = np.zeros((len(start), 11))
    results[:, :2], results[:, 10] = np.inf, -1.0
    pixels = np.ascontiguousarray(image, np.float32)
    grey_variance = float(noise[0]), float(noise[1])
    _fit_all(pixels, arms, float(blur), band, grey_variance, parameters, results)
    covariance, misfit = results[:, :2], results[:, 10]
    good = (misfit >= 0) & np.isfinite(parameters).all(1) & (covariance > 0).all(1)
    # 1.08: the biweight reduces Gaussian residuals by this factor more than the error of the estimate
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
