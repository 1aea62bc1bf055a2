"""Stereo at sea: two cameras on a platform, from lenses and a baseline to elevation, beside OpenCV's SGBM.

    python -m benchmarks.sea [--seeds N ...] [--frames N] [--folder DIR] [--only exact found sgbm]

The scene `sea` (12 m up, 2.5 m apart, the horizon in view, Hs .5 m), simulated anew for each seed unless
DIR/SEED holds it. Rows of a seed: how far the vertical of the cameras and their height are off, from lenses
and a baseline alone, and what is stated; z of exact cameras, and of those found, against the truth at the
nodes; E(omega) of `analyze` (Ez_fusion) where it is marked as valid, from half of the peak's frequency on,
against that of the true elevation at the same nodes; and the same images by SGBM (the block size with the
smallest error) with a plane fitted to all of its points.
Errors are in px (the mean side of a pixel in the middle of the grid). Records of 30 s: of 10 s, lines are .11
Hz wide beside a steep peak, and one segment is left.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import binned_statistic_2d

from benchmarks.options import parser_of
from wavefield.calibration.level_on_water import level_experiment
from wavefield.grid import Grid
from wavefield.pipeline.running import run
from wavefield.rig import Rig
from wavefield.rig.field import pixel_size
from wavefield.rig.water_level import fit_plane
from wavefield.series import Experiment
from wavefield.store.read import open_cube
from wavefield.tank import Scene, simulate
from wavefield.variables import Quality
from wavefield.waves import E_omega, fused_spectra
from wavefield.waves.gains import gain_of

Array = NDArray[Any]
BASELINE = 2.5  # m, of the scene
BLOCKS = (5, 9, 13)  # of SGBM, px
DISPARITIES = 128  # px


def turned_to(found: Rig, true: Rig) -> Rig:
    """A levelled rig, its x and y axes turned and moved to those of the true one; tilt and height stay."""
    ways = [rig["left"].R[0, :2] for rig in (found, true)]
    a, b = (np.arctan2(*way[::-1]) for way in ways)
    c, s = np.cos(a - b), np.sin(a - b)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    middle, there = (np.mean([rig[n].centre for n in rig], axis=0) * [1, 1, 0] for rig in (found, true))
    return found.moved(axes, middle - axes @ there)


def sgbm(images: Sequence[tuple[Array, Array]], rig: Rig, grid: Grid, block: int) -> Array:
    """Elevation at the nodes, (instants, ny, nx), by SGBM and a plane through the points of all instants."""
    left, right = rig["left"], rig["right"]
    R = right.R @ left.R.T
    size = left.size
    T = (right.T - R @ left.T).reshape(3, 1)
    R1, R2, P1, P2, Q = cv2.stereoRectify(left.K, left.D, right.K, right.D, size, R, T)[:5]
    maps = [
        cv2.initUndistortRectifyMap(c.K, c.D, R_, P_[:, :3], size, cv2.CV_32FC1)
        for c, R_, P_ in ((left, R1, P1), (right, R2, P2))
    ]
    matcher = cv2.StereoSGBM.create(
        0, DISPARITIES, block, 8 * block**2, 32 * block**2, 1, 31, 5, 100, 2, cv2.StereoSGBM_MODE_SGBM
    )
    clouds = []
    for pair in images:
        a, b = (cv2.remap(image, *m, cv2.INTER_CUBIC) for image, m in zip(pair, maps, strict=True))
        disparity = matcher.compute(a, b).astype(np.float32) / 16.0
        points = cv2.reprojectImageTo3D(disparity, Q)[disparity > 5.0].astype(float)
        clouds.append((points @ R1 - left.T) @ left.R)
    inside = [_in_view(cloud, grid) for cloud in clouds]
    every = np.concatenate(inside)
    plane = fit_plane(*every[:: max(1, len(every) // 200_000)].T)
    edges = [np.append(v - grid.step / 2, v[-1] + grid.step / 2) for v in (grid.x_nodes, grid.y_nodes)]
    out = []
    for cloud in inside:
        z = cloud[:, 2] - plane.height - cloud[:, :2] @ np.array(plane.slope)
        out.append(binned_statistic_2d(cloud[:, 1], cloud[:, 0], z, "median", bins=edges[::-1])[0])
    return np.stack(out)


def _in_view(cloud: Array, grid: Grid) -> Array:
    (x0, x1), (y0, y1), margin = grid.x, grid.y, grid.step
    keep = (cloud[:, 0] > x0 - margin) & (cloud[:, 0] < x1 + margin)
    keep &= (cloud[:, 1] > y0 - margin) & (cloud[:, 1] < y1 + margin) & (np.abs(cloud[:, 2]) < 2.0)
    return np.asarray(cloud[keep])


def rms(values: Array) -> float:
    """Root mean square of what is a number."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def of_rig(folder: Path, seed: int) -> Rig:
    """How far the vertical and the height are off, from lenses and a baseline alone."""
    true = Rig.load(folder / "truth" / "rig.yaml")
    found = level_experiment(folder / "experiment.yaml", distance=BASELINE)
    off = max(np.degrees(np.arccos(min(1.0, found.rig[n].R[:, 2] @ true[n].R[:, 2]))) for n in true)
    print(
        f"| {seed} | rig from lenses and a baseline | tilt {off:.3f} degrees (stated {found.tilt_std:.3f}), "
        f"height {100 * (found.height / true['left'].centre[2] - 1):+.2f} % (stated "
        f"{100 * found.height_std / found.height:.2f} %) |",
        flush=True,
    )
    return turned_to(found.rig, true)


def of_elevation(folder: Path, seed: int, name: str, rig: Rig) -> None:
    """z, E(omega) and Hs by a rig against the truth."""
    truth = xr.open_zarr(folder / "truth" / "truth.zarr").z.load()
    grid = Scene.load(folder / "scene.yaml").grid
    pixel = pixel_size(rig, grid)
    with TemporaryDirectory() as temporary:
        store = Path(temporary) / "cube.zarr"
        run(_with_grid(folder, grid), store, rig=rig)
        cube = open_cube(store).load()
    error, measured = cube.z.values - truth.values, (cube.quality.values & Quality.MEASURED) != 0
    within = np.mean(np.abs(error[measured]) < cube.z_std.values[measured])
    found = fused_spectra(cube, gain=gain_of(cube))
    true = E_omega(truth.assign_coords(cube.z.coords)).E.values
    peak = int(true.argmax())
    valid = found.valid_fusion.values & (found.frequency.values > 0.5 * found.frequency.values[peak])
    end = np.flatnonzero(valid)[-1]
    hs = [4 * np.nanstd(z) for z in (cube.z.values, truth.values)]
    print(
        f"| {seed} | z, {name} | rms {rms(error[measured]) / pixel:.3f} px of {100 * pixel:.1f} cm, stated "
        f"{rms(cube.z_std.values[measured]) / pixel:.3f}, within 1 std {100 * within:.0f} %, measured "
        f"{100 * measured.mean():.1f} %; E(omega) within "
        f"{100 * np.abs(found.Ez_fusion.values / true - 1)[valid].max():.0f} % to "
        f"{found.frequency.values[end]:.2f} Hz, "
        f"{np.log10(true[peak] / true[end]):.1f} decades below the peak; Hs {hs[0]:.3f} m of {hs[1]:.3f} |",
        flush=True,
    )


def of_sgbm(folder: Path, seed: int) -> None:
    """z by SGBM and a plane against the truth."""
    true, grid = Rig.load(folder / "truth" / "rig.yaml"), Scene.load(folder / "scene.yaml").grid
    start = xr.open_zarr(folder / "truth" / "truth.zarr").z_start.values[::4]
    series = Experiment.load(folder / "experiment.yaml").open_frames()
    images = [
        (np.asarray(series["left"].read(4 * k).image), np.asarray(series["right"].read(4 * k).image))
        for k in range(len(start))
    ]
    rows = {block: sgbm(images, true, grid, block) - start for block in BLOCKS}
    block = min(rows, key=lambda b: rms(rows[b]))
    print(
        f"| {seed} | SGBM of {block} px and a plane, exact cameras | rms "
        f"{rms(rows[block]) / pixel_size(true, grid):.3f} px, median absolute error "
        f"{np.nanmedian(np.abs(rows[block])) / pixel_size(true, grid):.3f} px, "
        f"{100 * np.isfinite(rows[block]).mean():.1f} % of the nodes |",
        flush=True,
    )


def _with_grid(folder: Path, grid: Grid) -> Path:
    """The lab note with the grid of the truth, beside the other."""
    text = (folder / "experiment.yaml").read_text(encoding="utf-8")
    path = folder / "with_grid.yaml"
    path.write_text(
        text + f"grid: {{x: {list(grid.x)}, y: {list(grid.y)}, step: {grid.step}}}\n", encoding="utf-8"
    )
    return path


def main(words: Sequence[str]) -> int:
    """Simulate and print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--only", nargs="+", choices=("exact", "found", "sgbm"), default=None)
    parser.add_argument("--folder", type=Path, help="where simulated seas are, or are put")
    options = parser.parse_args(words)
    print("| seed | | |\n|---|---|---|")
    with TemporaryDirectory() as temporary:
        for seed in options.seeds:
            folder = (options.folder or Path(temporary)) / str(seed)
            if not (folder / "truth" / "truth.zarr").exists():
                simulate(Scene.load("sea").with_(seed=seed, frames=options.frames), folder)
            only = options.only or ("exact", "found", "sgbm")
            if "exact" in only:
                of_elevation(folder, seed, "exact cameras", Rig.load(folder / "truth" / "rig.yaml"))
            if "found" in only:
                of_elevation(folder, seed, "cameras found", of_rig(folder, seed))
            if "sgbm" in only:
                of_sgbm(folder, seed)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
