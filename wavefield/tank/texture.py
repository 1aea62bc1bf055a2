"""Water without beads: noise painted on the surface, and the open sea towards the horizon.

The sight line of each pixel is followed to the water; there the pixel shows painted texture, or the sky's
reflection by the slope of the water with foam that it carries.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import map_coordinates

from wavefield.rig import Camera
from wavefield.tank.scene_parts import SeaSurface
from wavefield.tank.sea import Snapshot

Array = NDArray[np.float64]


class Paint:
    """Band-limited white noise as a function of position: a cubic B-spline with random coefficients.
    On a rectangle x, y with grains of a mesh, metres; it is mirrored beyond.
    """

    def __init__(self, x: tuple[float, float], y: tuple[float, float], mesh: float, seed: int) -> None:
        count = [int(np.ceil((high - low) / mesh)) + 5 for low, high in (x, y)]
        rng = np.random.default_rng([seed, 5])
        self._coefficients = rng.standard_normal((count[1], count[0]), np.float32)
        # the mean of sum B^2 over a cell is 0.479 along each axis: unit variance
        self._coefficients /= np.float32(0.4794)
        self._x0, self._y0, self._mesh = x[0] - 2 * mesh, y[0] - 2 * mesh, mesh

    def __call__(self, x: Array, y: Array) -> NDArray[np.float32]:
        """Texture at points of any shape, metres."""
        places = np.nan_to_num([(y - self._y0) / self._mesh, (x - self._x0) / self._mesh])
        out = np.empty(np.shape(x), np.float32)
        map_coordinates(self._coefficients, places, out, order=3, mode="grid-mirror", prefilter=False)
        return out


Image = NDArray[np.float32]

EARTH_RADIUS = 6.371e6  # m
COARSE = 4  # px between the sight lines that are followed down step by step
HEIGHTS = 24  # at which they are compared with the water
NEWTON_STEPS = 4
SUPERSAMPLING = 3  # rows per pixel: towards the horizon a pixel is much longer than wide
FADE = 0.25  # share of the distance to the end of the waves over which the texture fades
REFRACTIVE = 0.02  # reflected at normal incidence (Schlick 1994)
ROUGHNESS = 0.15  # rms of slopes too fine to be drawn: they keep the far sea darker than the sky


@dataclass(frozen=True)
class Seen:
    """What each pixel's sight line meets, (row, column); NaN for sky and beyond the waves."""

    x: Array  # m
    y: Array
    z: Array
    z_x: Array  # slopes
    z_y: Array


def horizon_dip(height: float) -> float:
    """Angle of the horizon below the horizontal, rad, from a height above the sea, m (without refraction)."""
    return float(np.sqrt(2.0 * height / EARTH_RADIUS))


def meet(camera: Camera, snapshot: Snapshot, reach: float) -> Seen:
    """The first water that each pixel's sight line meets, waves that hide others included.
    `snapshot` gives z, z_x and z_y; `reach` bounds the elevation, m.
    """
    width, height = camera.size
    x, y = camera.unproject(np.arange(float(width)), np.arange(float(height))[:, None])
    rows, columns = np.arange(0, height, COARSE), np.arange(0, width, COARSE)
    # every few pixels the sight line is followed down; from there Newton's steps of Z(x_a + D z) - z
    start = _first_crossing(camera, snapshot, reach, x[rows[:, None], columns], y[rows[:, None], columns])
    z = start[(np.arange(height) // COARSE)[:, None], np.arange(width) // COARSE]
    dx, dy = camera.sight_line(x, y)
    z_x = z_y = np.zeros_like(z)
    for _ in range(NEWTON_STEPS):
        found, z_x, z_y = snapshot(x + dx * z, y + dy * z)
        steepness = np.clip(1.0 - dx * z_x - dy * z_y, 0.2, 5.0)  # towards hidden water it goes to 0
        z = z + (found - z) / steepness
    return Seen(x + dx * z, y + dy * z, z, z_x, z_y)


def _first_crossing(camera: Camera, snapshot: Snapshot, reach: float, x: Array, y: Array) -> Array:
    dx, dy = camera.sight_line(x, y)
    out = np.full(x.shape, np.nan)
    above = np.full(x.shape, np.nan)
    levels = np.linspace(reach, -reach, HEIGHTS)
    for level in levels:
        over = level - snapshot(x + dx * level, y + dy * level)[0]
        crossed = np.isnan(out) & (over <= 0) & (above > 0)
        step = levels[0] - levels[1]
        with np.errstate(invalid="ignore", divide="ignore"):
            out = np.where(crossed, level - step * over / (over - above), out)
        above = over
    return out


def light(camera: Camera, seen: Seen, settings: SeaSurface, foam: Image, ripples: Image) -> Image:
    """Image (row, column), grey levels, of sky and water, without the camera's own noise.
    Each pixel of water is a facet with the slope of `seen` plus that of `ripples`. It mirrors the sky with
    Fresnel's reflectance over dark water; foam covers it where the texture `foam` exceeds its threshold.
    """
    width, height = camera.size
    a, b = camera.tangents(np.arange(float(width)), np.arange(float(height))[:, None])
    ray = np.stack([a, b, np.ones_like(a)], -1) @ camera.R  # away from the camera
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    sky = settings.sky * _radiance(ray[..., 2])
    known = np.isfinite(seen.z)
    slope_x, slope_y = (
        np.where(known, s, 0.0) + settings.ripple_slope * ripples for s in (seen.z_x, seen.z_y)
    )
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    facing = np.clip(np.hypot(np.maximum(-np.sum(ray * normal, axis=-1), 0.0), ROUGHNESS), 0.0, 1.0)
    upward = ray[..., 2] + 2.0 * facing * normal[..., 2]
    reflectance = REFRACTIVE + (1.0 - REFRACTIVE) * (1.0 - facing) ** 5
    water = settings.water + reflectance * settings.sky * _radiance(np.abs(upward))
    # foam covers the water where its texture is above a threshold
    cover = np.clip(foam - settings.foam_threshold, 0.0, 1.0)
    water += (settings.foam - water) * cover
    # the horizon crosses pixels: what of each is below it
    under = -np.sin(horizon_dip(camera.centre[2])) - ray[..., 2]
    below = np.clip(0.5 + under * camera.fy, 0.0, 1.0)
    return np.asarray(sky + below * (water - sky), np.float32)


def _radiance(upward: Array) -> Array:
    """Radiance of the sky relative to the horizon, by the sine of the elevation angle."""
    out: Array = 0.45 + 0.55 * (1.0 - np.clip(upward, 0.0, 1.0)) ** 3
    return out


def texture_at(
    seen: Seen, drift: Sequence[RectBivariateSpline], paints: Sequence[Paint], far: float
) -> Image:
    """Sum of paints, mean over each pixel, (row, column), carried by the water since the first frame.
    `drift`, of (y, x), gives where the water was minus where it is, m; waves end at the distance `far`, m.
    """
    width, height = seen.x.shape[1], seen.x.shape[0]
    fine = []
    for place, moved in zip((seen.x, seen.y), drift, strict=True):
        known = np.nan_to_num(place)
        part = moved.ev(np.nan_to_num(seen.y)[::COARSE, ::COARSE], np.nan_to_num(seen.x)[::COARSE, ::COARSE])
        back = _enlarged(part, seen.x.shape)
        enlarged = cv2.resize(known + back, (width, SUPERSAMPLING * height), interpolation=cv2.INTER_LINEAR)
        fine.append(np.asarray(enlarged, float))
    total = np.sum([paint(fine[0], fine[1]) for paint in paints], axis=0)
    mean = total.reshape(height, SUPERSAMPLING, width).mean(axis=1)
    visible = np.clip((far - np.hypot(seen.x, seen.y)) / (FADE * far), 0.0, 1.0)
    return np.where(np.isfinite(seen.z), mean * visible, 0.0).astype(np.float32)


def _enlarged(coarse: Array, shape: tuple[int, ...]) -> Array:
    """A field (row, column) of every few pixels on every pixel, linear between and beyond them."""
    rows, columns = (np.arange(n) / COARSE for n in shape[:2])
    at = np.meshgrid(columns.astype(np.float32), rows.astype(np.float32))
    return np.asarray(
        cv2.remap(coarse, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), float
    )
