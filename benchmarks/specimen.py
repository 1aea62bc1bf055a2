"""Real images of a specimen under load: surface and displacements against a public code's own results.

    python -m benchmarks.specimen FOLDER [--pictures DIR]
    python -m benchmarks.specimen FOLDER --images "images/img_{n:04d}_{c}.tif" --reference "gold/..._{n}.txt"

FOLDER holds cal.xml, images and results of DICe, called as in its D-specimen unless stated. The reference's
matches (left to right at rest, left to left under load) are turned into positions with the same rig; the
measurement sees the images alone.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from benchmarks.options import parser_of
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
    fields: dict[str, np.ndarray]


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
                fields=out,
            )
        )
    return geometry, found


def compare(
    folder: Path, pictures: Path | None = None, images_at: str = IMAGES, results_at: str = REFERENCE
) -> list[tuple[str, str, str]]:
    """Median differences, as (test, asked, reached)."""
    geometry, found = differences(folder, images_at=images_at, results_at=results_at)
    rows = [
        (
            "specimen: rectified pixel, um; lattice",
            "",
            f"{geometry.pixel / MICRON:.1f}; {geometry.lattice.shape}",
        )
    ]
    for each in found:
        moved = ", ".join(f"{d / MICRON:.1f}" for d in each.moved)
        rows.append(
            (
                f"specimen, load {each.load}: median |difference| in plane; z, um",
                "3; 8",
                f"{each.plane / MICRON:.2f}; {each.z / MICRON:.2f}  ({each.points} points;"
                f" mean z {each.mean_z / MICRON:+.1f}; moved {moved})",
            )
        )
        if pictures:
            draw(each.fields, geometry.grid, pictures / f"specimen_{each.load}.png")
    return rows


def draw(out, grid: Grid, path: Path) -> None:
    """The four fields of one load."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(2, 2, figsize=(11, 6.5), constrained_layout=True)
    names = {"z": "elevation", "u": "displacement along x", "v": "along y", "w": "along z"}
    for axis, (name, label) in zip(axes.flat, names.items(), strict=True):
        field = np.where((out["quality"] & Quality.MEASURED) > 0, out[name], np.nan) / MICRON
        low, high = np.nanpercentile(field, (2, 98))
        extent = 1e3 * np.array([*grid.x, *grid.y])
        shown = axis.imshow(field, origin="lower", extent=extent, vmin=low, vmax=high, cmap="viridis")
        axis.set(title=f"{label} (um)", xlabel="x (mm)", ylabel="y (mm)")
        figure.colorbar(shown, ax=axis, shrink=0.8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    cv2.setNumThreads(1)
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the fields")
    parser.add_argument("--images", default=IMAGES, help="images: {n} is the load, {c} the camera, 0 or 1")
    parser.add_argument("--reference", default=REFERENCE, help="DICe's results of load {n}")
    options = parser.parse_args()
    for test, asked, reached in compare(options.folder, options.pictures, options.images, options.reference):
        print(f"{test:58s} {asked:>10s}   {reached}", flush=True)


if __name__ == "__main__":
    main()
