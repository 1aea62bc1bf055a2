"""Pictures of targets with exact truth; shares no code with the detectors.

Strings are strips blurred by the lens in closed form and integrated over each square pixel (a thin string
that is blurred only after it was put into pixels could move within its row unseen). Discs and other patterns
are supersampled and then blurred. The picture is lit and given dirt, photon noise, read noise and 8 bits.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.special import ndtr

from wavefield.rig import Camera


def camera_at(
    size=(1024, 1024), tilt=0.0, turn=0.0, roll=0.0, distance=4.0, focal=2700.0, at=(0.0, 0.0), k1=-0.1
):
    """A camera directed at the point `at` of the target plane.

    tilt: obliquity, degrees from the normal; turn: azimuth of the camera about z; roll: about its axis.
    """
    t, a, r = np.deg2rad([tilt, turn, roll])
    normal = np.array([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)])
    side = np.array([-np.sin(a), np.cos(a), 0.0])
    down = np.cross(-normal, side)
    R = np.stack([np.cos(r) * side + np.sin(r) * down, -np.sin(r) * side + np.cos(r) * down, -normal])
    target = np.array([*at, 0.0])
    centre = target + distance * normal
    w, h = size
    return Camera(focal, focal, (w - 1) / 2, (h - 1) / 2, R, -R @ centre, size, k1=k1)


@dataclass(frozen=True)
class Picture:
    """How the picture is taken: lengths in metres, greys in counts of 8 bits."""

    string: float = 0.002  # diameter of a string
    origin_radius: float = 0.018
    x_radius: float = 0.011
    blur: float = 0.6  # lens, px
    dark: float = 15.0
    bright: float = 180.0
    light: float = 0.0  # 0 even, towards 1 uneven
    gain: float = 100.0  # electrons per count
    read: float = 0.6  # counts
    dust: int = 0
    spots: int = 0
    ghost: float = 0.0  # strength of a reflection of the strings
    ghost_shift: float = 0.012
    seed: int = 0


def plane_coordinates(camera, step=8):
    """Target coordinates (x, y) of every pixel, from exact ones every few pixels by a quintic spline."""
    w, h = camera.size
    X, Y = np.arange(-2 * step, w + 3 * step, step, float), np.arange(-2 * step, h + 3 * step, step, float)
    coarse = camera.unproject(*np.meshgrid(X, Y))
    if not np.isfinite(coarse).all():
        return camera.unproject(*np.meshgrid(np.arange(w, dtype=float), np.arange(h, dtype=float)))
    fine = np.arange(h, dtype=float), np.arange(w, dtype=float)
    return tuple(RectBivariateSpline(Y, X, c, kx=5, ky=5)(*fine) for c in coarse)


def strings_cover(camera, mesh, extent, width, blur, shift=(0.0, 0.0)):
    """Blurred fraction of every pixel covered by strings; extent = (i0, i1, j0, j1) of the crossings."""
    x, y = plane_coordinates(camera)
    x, y = x - shift[0], y - shift[1]
    i0, i1, j0, j1 = np.array(extent) * mesh
    edge = 0.7 * mesh
    at, weight = np.polynomial.legendre.leggauss(4)
    free = [np.ones_like(x) for _ in range(16)]
    for q, p, lo, hi, p0, p1 in ((y, x, j0, j1, i0, i1), (x, y, i0, i1, j0, j1)):
        nearest = np.clip(np.rint(q / mesh) * mesh, lo, hi)
        gy, gx = np.gradient(q)
        g = np.hypot(gx, gy)
        near = (np.abs(q - nearest) < width / 2 + (5 * blur + 1) * g) & (p > p0 - edge) & (p < p1 + edge)
        q, g, gx, gy = q[near] - nearest[near], g[near], gx[near], gy[near]
        for k in range(16):
            d = (q + gx * at[k // 4] / 2 + gy * at[k % 4] / 2) / g
            free[k][near] *= 1 - ndtr((d + width / 2 / g) / blur) + ndtr((d - width / 2 / g) / blur)
    return 1 - sum(f * weight[k // 4] * weight[k % 4] / 4 for k, f in enumerate(free))


def disc_cover(camera, centre, radius, samples=9):
    """Fraction of every pixel covered by a disc on the plane, by supersampling."""
    w, h = camera.size
    cover = np.zeros((h, w))
    angle = np.linspace(0, 2 * np.pi, 60)
    X, Y = camera.project(centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle), 0.0)
    if not np.isfinite(X).all():
        return cover
    x0, x1 = int(max(X.min() - 2, 0)), int(min(X.max() + 3, w))
    y0, y1 = int(max(Y.min() - 2, 0)), int(min(Y.max() + 3, h))
    if x0 >= x1 or y0 >= y1:
        return cover
    o = (np.arange(samples) + 0.5) / samples - 0.5
    gx, gy = np.meshgrid((np.arange(x0, x1)[:, None] + o).ravel(), (np.arange(y0, y1)[:, None] + o).ravel())
    px, py = camera.unproject(gx, gy)
    inside = np.hypot(px - centre[0], py - centre[1]) < radius
    cover[y0:y1, x0:x1] = inside.reshape(y1 - y0, samples, x1 - x0, samples).mean((1, 3))
    return cover


def expose(scene, picture):
    """Light, dirt, noise and 8 bits, for a picture of reflectances 0 to 1."""
    rng = np.random.default_rng(picture.seed)
    h, w = scene.shape
    Y, X = np.mgrid[0:h, 0:w]
    if picture.dust:
        for _ in range(picture.dust):
            cx, cy, r = rng.uniform(0, w), rng.uniform(0, h), rng.uniform(0.7, 2.5)
            x0, x1, y0, y1 = int(max(cx - 9, 0)), int(cx + 9), int(max(cy - 9, 0)), int(cy + 9)
            patch = np.exp(-((X[y0:y1, x0:x1] - cx) ** 2 + (Y[y0:y1, x0:x1] - cy) ** 2) / (2 * r * r))
            scene[y0:y1, x0:x1] += (rng.choice([-1, 1]) * 0.6) * patch * (scene[y0:y1, x0:x1] + 0.15)
    scene = np.clip(scene, 0, None)
    light = 1.0 - picture.light * (
        0.5 * np.hypot((X - 0.35 * w) / w, (Y - 0.4 * h) / h) + 0.5 * (X + Y) / (w + h)
    )
    counts = (picture.dark + (picture.bright - picture.dark) * scene) * light
    for _ in range(picture.spots):
        cx, cy, r = rng.uniform(0, w), rng.uniform(0, h), rng.uniform(1.5, 7)
        stretch, turn = rng.uniform(1, 3), rng.uniform(0, np.pi)
        a, b = (
            (X - cx) * np.cos(turn) + (Y - cy) * np.sin(turn),
            (Y - cy) * np.cos(turn) - (X - cx) * np.sin(turn),
        )
        counts += 400 * np.exp(-((a / stretch) ** 2 + b**2) / (2 * r * r))
    noise = np.sqrt(np.maximum(counts, 0) / picture.gain + picture.read**2)
    return np.clip(np.rint(counts + noise * rng.normal(size=counts.shape)), 0, 255).astype(np.uint8)


def string_picture(camera, picture=Picture(), mesh=0.10, extent=(-12, 12, -12, 12), marks=True):
    """A picture of a grid of strings with its two marks."""
    cover = strings_cover(camera, mesh, extent, picture.string, picture.blur)
    if picture.ghost:
        ghost = strings_cover(camera, mesh, extent, picture.string, picture.blur, (picture.ghost_shift,) * 2)
        cover = np.maximum(cover, picture.ghost * ghost)
    if marks:
        for centre, radius in (((0.0, 0.0), picture.origin_radius), ((mesh, 0.0), picture.x_radius)):
            disc = cv2.GaussianBlur(disc_cover(camera, centre, radius), (0, 0), picture.blur)
            cover = np.maximum(cover, disc)
    return expose(cover, picture)


def string_truth(camera, mesh=0.10, extent=(-12, 12, -12, 12), margin=5.0):
    """Nodes in view, at least a margin inside the picture, but for the two under the marks."""
    i, j = np.meshgrid(np.arange(extent[0], extent[1] + 1), np.arange(extent[2], extent[3] + 1))
    node = np.c_[i.ravel(), j.ravel()]
    node = node[~((node[:, 1] == 0) & ((node[:, 0] == 0) | (node[:, 0] == 1)))]
    return node[camera.sees(node[:, 0] * mesh, node[:, 1] * mesh, 0.0, margin)]


def pattern_picture(camera, inside, picture=Picture(), samples=4):
    """A picture of any pattern: inside(x, y) gives the reflectance, 0 to 1; supersampled."""
    return expose(pattern_cover(camera, inside, picture, samples), picture)


def two_level_picture(camera, mesh, depth, diameter, extent, marks, picture=Picture(), samples=4):
    """White dots on two planes, those of odd rows deeper; a square and a triangle mark the origin."""

    def shapes(dx, dy):
        h = 0.7 * diameter
        square = np.maximum(abs(dx), abs(dy)) < 0.5 * diameter
        return square, (dy > -h / 2) & (abs(dx) * np.sqrt(3) < h - dy)

    def level(odd):
        def inside(x, y):
            i, j = (2 * np.rint((v / mesh - odd) / 2).astype(int) + odd for v in (x, y))
            dx, dy = x - i * mesh, y - j * mesh
            out = np.hypot(dx, dy) < diameter / 2
            i0, i1, j0, j1 = extent
            out = (i >= i0) & (i <= i1) & (j >= j0) & (j <= j1) & out
            for k, (a, b) in enumerate(marks):
                if (a + b) % 2 and b % 2 == odd:
                    out = out | shapes(x - a * mesh, y - b * mesh)[k]
            return np.where(out, 1.0, 0.0)

        return inside

    lower = replace(camera, translation=camera.T - camera.R @ np.array([0.0, 0.0, depth]))
    cover = pattern_cover(camera, level(0), picture, samples) + pattern_cover(
        lower, level(1), picture, samples
    )
    return expose(cover, picture)


def pattern_cover(camera, inside, picture, samples=4):
    """Blurred reflectance of every pixel."""
    camera = camera.scaled(2)
    w, h = camera.size
    x, y = camera.unproject(*np.meshgrid(np.arange(w, dtype=float), np.arange(h, dtype=float)))
    (x_Y, x_X), (y_Y, y_X) = (
        np.gradient(x),
        np.gradient(y),
    )  # straight within a pixel, to a ten-thousandth of it
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    out = sum(inside(x + a * x_X + b * x_Y, y + a * y_X + b * y_Y) for a in offsets for b in offsets)
    out = np.asarray(out, float) / samples**2
    out = cv2.GaussianBlur(out, (0, 0), 2 * picture.blur)
    return out.reshape(h // 2, 2, w // 2, 2).mean((1, 3))


def chessboard(shape, mesh):
    """Reflectance of a chessboard with shape inner corners, the first at (0, 0), and a white margin."""
    nx, ny = shape

    def inside(x, y):
        a, b = np.floor(x / mesh).astype(int), np.floor(y / mesh).astype(int)
        on = (a >= -1) & (a < nx) & (b >= -1) & (b < ny)
        return np.where(on & ((a + b) % 2 == 0), 0.0, 1.0)

    return inside


def dots(shape, mesh, diameter, bright=False):
    """Reflectance of a grid of round dots, the first at (0, 0)."""
    nx, ny = shape

    def inside(x, y):
        i, j = np.clip(np.rint(x / mesh), 0, nx - 1), np.clip(np.rint(y / mesh), 0, ny - 1)
        dot = np.hypot(x - i * mesh, y - j * mesh) < diameter / 2
        return np.where(dot, 1.0, 0.0) if bright else np.where(dot, 0.0, 1.0)

    return inside


def charuco(shape, mesh, marker, dictionary=cv2.aruco.DICT_4X4_50):
    """Reflectance of a ChArUco board; its inner corner at the lower left is (0, 0), y upwards."""
    nx, ny = shape
    board = cv2.aruco.CharucoBoard(shape, mesh, marker, cv2.aruco.getPredefinedDictionary(dictionary))
    scale = 120
    drawn = board.generateImage((nx * scale, ny * scale), marginSize=0, borderBits=1)

    def inside(x, y):
        column = np.floor((x / mesh + 1) * scale).astype(int)
        row = np.floor((ny - 1 - y / mesh) * scale).astype(int)
        on = (column >= 0) & (column < nx * scale) & (row >= 0) & (row < ny * scale)
        value = drawn[np.clip(row, 0, ny * scale - 1), np.clip(column, 0, nx * scale - 1)] / 255
        return np.where(on, value, 1.0)

    return inside


def centred(camera, shape, mesh):
    """The camera moved so that it sees the middle of a grid of nodes where it saw the origin."""
    middle = np.array([(shape[0] - 1) / 2 * mesh, (shape[1] - 1) / 2 * mesh, 0.0])
    return replace(camera, translation=camera.T - camera.R @ middle)


def write_points(path, points):
    """Write target points as a CSV file that `read_points` reads."""
    heights = points.z if points.placed and points.z is not None else None
    lines = [f"# size {points.size[0]} {points.size[1]}", "i,j,X,Y,std" + ("" if heights is None else ",z")]
    for k, ((i, j), (x, y), std) in enumerate(zip(points.node, points.pixel, points.std, strict=True)):
        z = "" if heights is None else f",{float(heights[k])!r}"
        lines.append(f"{i},{j},{float(x)!r},{float(y)!r},{float(std)!r}{z}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
