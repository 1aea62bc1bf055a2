"""Images of water without beads: a surface painted with noise, or the open sea up to the horizon.

Each pixel shows what its sight line meets first: painted texture, or the reflection of the sky by the sloping
water, and foam.
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
    """Random texture on a rectangle x, y, m: band-limited white noise of unit variance (a cubic B-spline).
    `mesh`, m, is the size of its grains. The texture is mirrored beyond the rectangle."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float], mesh: float, seed: int) -> None:
        count = [int(np.ceil((high - low) / mesh)) + 5 for low, high in (x, y)]
        rng = np.random.default_rng([seed, 5])
        self._coefficients = rng.standard_normal((count[1], count[0]), np.float32)
        # sum B^2 of cubic B-splines averages .479 over a cell along each axis; dividing gives unit variance
        self._coefficients /= np.float32(0.4794)
        self._x0, self._y0, self._mesh = x[0] - 2 * mesh, y[0] - 2 * mesh, mesh

    def __call__(self, x: Array, y: Array) -> NDArray[np.float32]:
        """Return the texture at points x, y, metres, in the shape of x."""
        places = np.nan_to_num([(y - self._y0) / self._mesh, (x - self._x0) / self._mesh])
        out = np.empty(np.shape(x), np.float32)
        map_coordinates(self._coefficients, places, out, order=3, mode="grid-mirror", prefilter=False)
        return out


Image = NDArray[np.float32]

EARTH_RADIUS = 6.371e6  # m
COARSE = 4  # every so-many-th pixel a sight line is followed downwards, level by level
HEIGHTS = 24  # levels at which it is compared with the water
NEWTON_STEPS = 4  # from the crossing found at these levels, for every pixel
SUPERSAMPLING = 3  # rows per pixel: near the horizon a pixel covers a much longer than wide piece of water
FADE = 0.25  # the texture fades over this fraction of the distance to the end of the simulated waves
REFLECTANCE = 0.02  # of water at normal incidence (Schlick 1994)
ROUGHNESS = 0.15  # rms slope too fine to be drawn, which keeps the far sea darker than the sky


@dataclass(frozen=True)
class VisibleWater:
    """Position and slope of the water that each pixel shows, (row, column); NaN if the pixel shows none."""

    x: Array  # positions of the water, m
    y: Array
    z: Array
    z_x: Array  # slopes of the water
    z_y: Array


def horizon_dip(height: float) -> float:
    """Return the angle, rad, of the horizon below the horizontal from a height, m, without refraction."""
    return float(np.sqrt(2.0 * height / EARTH_RADIUS))


def visible_water(camera: Camera, snapshot: Snapshot, reach: float) -> VisibleWater:
    """Return the water that the sight line of each pixel meets first.
    `snapshot` gives z, z_x and z_y as a function of x and y; `reach` is the highest elevation, m."""
    width, height = camera.size
    x, y = camera.unproject(np.arange(float(width)), np.arange(float(height))[:, None])
    rows, columns = np.arange(0, height, COARSE), np.arange(0, width, COARSE)
    # a coarse search every few pixels, then Newton's method for z(x + dx z, y + dy z) = z at every pixel
    start = _first_crossing(camera, snapshot, reach, x[rows[:, None], columns], y[rows[:, None], columns])
    z = start[(np.arange(height) // COARSE)[:, None], np.arange(width) // COARSE]
    dx, dy = camera.sight_line(x, y)
    z_x = z_y = np.zeros_like(z)
    for _ in range(NEWTON_STEPS):
        found, z_x, z_y = snapshot(x + dx * z, y + dy * z)
        steepness = np.clip(1.0 - dx * z_x - dy * z_y, 0.2, 5.0)  # 0 where the sight line grazes a crest
        z = z + (found - z) / steepness
    return VisibleWater(x + dx * z, y + dy * z, z, z_x, z_y)


def _first_crossing(camera: Camera, snapshot: Snapshot, reach: float, x: Array, y: Array) -> Array:
    """Return the elevation, m, where sight lines through (x, y, 0) first meet the water; NaN if they do not.
    `snapshot` is a function of x, y with z first in its result; `reach` is the highest elevation, m."""
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


def sea_image(camera: Camera, seen: VisibleWater, settings: SeaSurface, foam: Image, ripples: Image) -> Image:
    """Return the image of sky and water (row, column), in grey levels of 255, before blur and noise.
    Water with the slopes of `seen` plus those of `ripples` mirrors the sky (Fresnel). Where the texture
    `foam` exceeds a threshold, foam covers it."""
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
    reflectance = REFLECTANCE + (1.0 - REFLECTANCE) * (1.0 - facing) ** 5
    water = settings.water + reflectance * settings.sky * _radiance(np.abs(upward))
    cover = np.clip(foam - settings.foam_threshold, 0.0, 1.0)
    water += (settings.foam - water) * cover
    # the fraction of each pixel that is below the horizon
    under = -np.sin(horizon_dip(camera.centre[2])) - ray[..., 2]
    below = np.clip(0.5 + under * camera.fy, 0.0, 1.0)
    return np.asarray(sky + below * (water - sky), np.float32)


def _radiance(upward: Array) -> Array:
    """Return the radiance of the sky relative to that at the horizon.
    `upward` is the sine of the angle above the horizon."""
    out: Array = 0.45 + 0.55 * (1.0 - np.clip(upward, 0.0, 1.0)) ** 3
    return out


def texture_at(
    seen: VisibleWater, drift: Sequence[RectBivariateSpline], paints: Sequence[Paint], far: float
) -> Image:
    """Return the sum of textures that move with the water, (row, column); it is zero beyond `far`, m.
    `drift` holds two functions of (y, x): displacements along x and y, m, back to the place at frame 0."""
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
    """Return an image of the given shape, interpolated linearly from values at every `COARSE`-th pixel."""
    rows, columns = (np.arange(n) / COARSE for n in shape[:2])
    at = np.meshgrid(columns.astype(np.float32), rows.astype(np.float32))
    return np.asarray(
        cv2.remap(coarse, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), float
    )
