"""Real images of a specimen under load: surface and displacements against a public code's own results.

    python -m benchmarks.specimen FOLDER [--save]
    python -m benchmarks.specimen FOLDER --images "images/img_{n:04d}_{c}.tif" --reference "gold/..._{n}.txt"

FOLDER holds cal.xml, images and results of DICe, called as in its D-specimen unless stated. The reference's
matches (left to right at rest, left to left under load) are turned into positions with the same rig; the
measurement sees the images alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from benchmarks.results import parser_of, print_table, save_result
from wavefield.grid import Grid
from wavefield.images import read_image
from wavefield.measurement import GridGeometry, measure
from wavefield.rig import Rig
from wavefield.rig.formats import load_rig
from wavefield.rig.stereo import triangulate as nearest_point
from wavefield.rig.water_level import level
from wavefield.variables import Quality

MICRON = 1e-6
IMAGES = "images/GT4-{n:04d}_{c}.tif"
REFERENCE = "reference/DICe_solution_{n}.txt"


def triangulate(rig: Rig, left, right):
    """Points seen at pixels of both cameras, midway between their lines of sight, (n, 3)."""
    rays = []
    for name, (X, Y) in (("left", left), ("right", right)):
        camera = rig[name]
        direction = np.stack([*camera.tangents(X, Y), np.ones_like(X)], axis=-1) @ camera.R
        rays.append((camera.centre, direction / np.linalg.norm(direction, axis=-1, keepdims=True)))
    (p, u), (q, v) = rays
    across, to_u, to_v = np.sum(u * v, axis=-1), u @ (p - q), v @ (p - q)
    s = (across * to_v - to_u) / (1 - across**2)
    t = (to_v - across * to_u) / (1 - across**2)
    return 0.5 * (p + s[:, None] * u + q + t[:, None] * v)


@dataclass(frozen=True)
class Difference:
    """One load against the reference's points, metres."""

    load: int
    points: int
    plane: float  # medians of the absolute differences
    z: float
    mean_z: float
    moved: tuple[float, float, float]  # medians


def differences(
    folder: Path, loads: Sequence[int] = range(1, 6), images_at: str = IMAGES, results_at: str = REFERENCE
) -> tuple[GridGeometry, list[Difference]]:
    """Measure the specimen under the given loads; read the results at the reference's points."""
    names = ("left", "right")
    rig = load_rig(folder / "cal.xml", names=list(names))
    images = {
        name: {n: read_image(folder / images_at.format(n=n, c=c)) for n in (0, *loads)}
        for c, name in enumerate(names)
    }
    tables = {
        n: np.genfromtxt(folder / results_at.format(n=n), delimiter=",", names=True, comments="*")
        for n in (0, *loads)
    }
    rest = tables[0]
    left = rest["COORDINATE_X"], rest["COORDINATE_Y"]
    right = left[0] + rest["CROSS_CORR_Q"], left[1] + rest["CROSS_CORR_R"]
    # z = 0 is the specimen's own plane
    rig, _ = level(rig, *triangulate(rig, left, right).T)
    seen = [rig[name].unproject(*pixels) for name, pixels in zip(names, (left, right), strict=True)]
    sight = [rig[name].sight_line(*at) for name, at in zip(names, seen, strict=True)]
    _, _, z, _ = nearest_point(seen, sight)
    x, y = np.asarray(seen[0]) + np.asarray(sight[0]) * z  # DICe's points are exact in the left image
    good = (rest["MATCH"] >= 0) & np.isfinite(z)
    grid = Grid((x[good].min(), x[good].max() + 5e-4), (y[good].min(), y[good].max() + 5e-4), 5e-4)
    geometry = GridGeometry(rig, grid)

    def read(field, px, py):
        return map_coordinates(
            field, [(py - grid.y[0]) / grid.step, (px - grid.x[0]) / grid.step], order=1, cval=np.nan
        )

    found = []
    for n in loads:
        frames = {name: [None, None, images[name][0], images[name][n], None, None] for name in names}
        out = {name: field[0] for name, field in measure(frames, geometry, 1.0).items()}
        measured = ((out["quality"] & Quality.MEASURED) > 0).astype(float)
        ok = good & (tables[n]["MATCH"] >= 0) & (read(measured, x, y) > 0.99)
        moved = left[0] + tables[n]["DISPLACEMENT_X"], left[1] + tables[n]["DISPLACEMENT_Y"]
        # left-left alone does not give the motion in depth: that is taken from the measurement
        start, end = rig["left"].unproject(*left, z), rig["left"].unproject(*moved, z + read(out["w"], x, y))
        dx, dy = end[0] - start[0], end[1] - start[1]
        middle = x + 0.5 * dx, y + 0.5 * dy
        plane = np.hypot(read(out["u"], *middle) - dx, read(out["v"], *middle) - dy)
        height = read(out["z"] - 0.5 * out["z_t"], x, y) - z
        found.append(
            Difference(
                load=n,
                points=int(np.sum(ok)),
                plane=float(np.nanmedian(plane[ok])),
                z=float(np.nanmedian(np.abs(height[ok]))),
                mean_z=float(np.nanmean(height[ok])),
                moved=tuple(float(np.nanmedian(d)) for d in (dx[ok], dy[ok], out["w"][measured > 0])),
            )
        )
    return geometry, found


def main() -> None:
    cv2.setNumThreads(1)
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--images", default=IMAGES, help="images: {n} is the load, {c} the camera, 0 or 1")
    parser.add_argument("--reference", default=REFERENCE, help="DICe's results of load {n}")
    options = parser.parse_args()
    geometry, found = differences(options.folder, images_at=options.images, results_at=options.reference)
    print(f"rectified pixel {geometry.pixel / MICRON:.1f} um; lattice {geometry.lattice.shape}")
    columns = ("load", "points", "in plane, um", "z, um", "mean of z, um", "moved along x, y, z, um")
    rows = []
    for each in found:
        moved = ", ".join(f"{d / MICRON:.1f}" for d in each.moved)
        cells = (f"{value / MICRON:.2f}" for value in (each.plane, each.z, each.mean_z))
        rows.append([str(each.load), str(each.points), *cells, moved])
    print_table(columns, rows)
    if options.save:
        save_result("specimen", columns, rows)


if __name__ == "__main__":
    main()
