"""How well targets are found, on pictures drawn with exact truth and on real chessboards.

Run: python -m benchmarks.targets [path of the folder that holds data/stereo_chessboard]
"""

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests" / "calibration"))

import cv2
import numpy as np
from rendering import (
    Picture,
    camera_at,
    centred,
    charuco,
    chessboard,
    dots,
    pattern_picture,
    string_picture,
    string_truth,
)

from wavefield.calibration import Target, find_target
from wavefield.errors import CalibrationError
from wavefield.images import read_image

GOOD = Picture(light=0.5)
LOW = Picture(light=0.3, bright=45, gain=8, read=2)
# name: tilt, picture, asked: least found (%), false points, rms per axis (px)
SCENES = {
    "45 degrees, good light": (45, GOOD, 99, 0, 0.01),
    "flat, good light": (0, GOOD, 99, 0, 0.01),
    "low light and noise": (45, LOW, 95, 0, None),
    "peak 100, noise 15": (30, replace(GOOD, bright=100, read=15), 95, 0, None),
    "65 degrees": (65, GOOD, 95, 0, None),
    "dust and specular spots": (45, replace(GOOD, dust=400, spots=20), 90, 0, 0.05),
    "strings of 1 mm": (45, replace(GOOD, string=0.001), None, 0, None),
    "ghost strings (40 %, 12 mm beside)": (45, replace(GOOD, ghost=0.4), None, 0, None),
}
SIZES = {(1024, 1024): (2700.0, 3), (2432, 1728): (4500.0, 2)}  # focal length, seeds


def strings() -> None:
    print(
        f"{'string grid':36s} {'size':>10s} {'asked: found/false/rms':>24s} {'found':>8s} {'false':>5s} "
        f"{'rms X, Y px':>15s} {'in 1 std':>8s} {'CPU s':>6s}"
    )
    for size, (focal, seeds) in SIZES.items():
        find_target(string_picture(camera_at((512, 512), 20)), Target("strings", 0.1))  # compiles
        for name, (tilt, picture, least, none, most) in SCENES.items():
            count = seen = false = 0
            errors, within, seconds = [], [], []
            for seed in range(seeds):
                rng = np.random.default_rng([seed, tilt])
                turn, roll = rng.uniform(0, 360, 2)
                camera = camera_at(size, tilt, turn, roll, 4.0, focal, rng.uniform(-0.3, 0.3, 2))
                image = string_picture(camera, replace(picture, seed=seed))
                node, _ = string_truth(camera, margin=5.0)
                count += len(node)
                begin = time.process_time()
                try:
                    points = find_target(image, Target("strings", 0.1))
                except CalibrationError as error:
                    print(f"    seed {seed}: {error}")
                    continue
                finally:
                    seconds.append(time.process_time() - begin)
                got = set(map(tuple, points.node))
                seen += sum(tuple(n) in got for n in node)
                x, y = points.node.T * 0.1
                error = points.pixel - np.stack(camera.project(x, y, 0.0), -1)
                sane = (np.hypot(*error.T) < 0.5) & (np.abs(points.node) <= 12).all(1)
                false += int((~sane).sum())
                errors.append(error[sane])
                within.append(np.abs(error[sane]) < points.std[sane, None])
            rms = np.sqrt((np.concatenate(errors) ** 2).mean(0)) if errors else np.full(2, np.nan)
            share = np.concatenate(within).mean() if within else np.nan
            asked = f"{least or '-'} % / {none} / {most or '-'}"
            print(
                f"{name:36s} {size[0]:5d}x{size[1]:4d} {asked:>24s} {100 * seen / count:6.2f} % {false:5d} "
                f"{rms[0]:7.4f} {rms[1]:7.4f} {100 * share:6.0f} % {np.mean(seconds):6.2f}",
                flush=True,
            )


def printed() -> None:
    print(
        f"\n{'printed target':36s} {'tilt':>6s} {'points':>7s} {'rms px':>8s} {'mean px':>16s} "
        f"{'std px':>7s} {'in 1 std':>8s}"
    )
    board, grid = (9, 6), (11, 9)
    cases = {
        "chessboard": (board, 0.05, chessboard(board, 0.05), Target("chessboard", 0.05, board)),
        "ChArUco": (
            board,
            0.05,
            charuco((10, 7), 0.05, 0.037),
            Target("charuco", 0.05, (10, 7), marker=0.037),
        ),
        "dots 20 mm": (grid, 0.04, dots(grid, 0.04, 0.02), Target("dots", 0.04, grid, diameter=0.02)),
        "dots 20 mm, diameter not stated": (grid, 0.04, dots(grid, 0.04, 0.02), Target("dots", 0.04, grid)),
        "dots 10 mm": (grid, 0.04, dots(grid, 0.04, 0.01), Target("dots", 0.04, grid, diameter=0.01)),
    }
    for name, (shape, mesh, pattern, target) in cases.items():
        for tilt in (0, 45):
            camera = centred(camera_at((1024, 1024), tilt, 40.0, 205.0, 2.0, 2700.0), shape, mesh)
            picture = Picture(dark=20, bright=200, light=0.5, seed=tilt)
            points = find_target(pattern_picture(camera, pattern, picture, samples=3), target)
            x, y = points.node.T * mesh
            error = points.pixel - np.stack(camera.project(x, y, 0.0), -1)
            share = np.mean(np.abs(error) < points.std[:, None])
            print(
                f"{name:36s} {tilt:6d} {len(points):7d} {np.sqrt((error**2).mean()):8.4f} "
                f"{error[:, 0].mean():+8.4f}{error[:, 1].mean():+8.4f} "
                f"{np.median(points.std):7.4f} {100 * share:6.0f} %",
                flush=True,
            )


def real(folder: Path) -> None:
    if not folder.is_dir():
        print(f"\n{folder} is not there: real chessboards left out")
        return
    print("\nreal chessboards          found   scatter about a smooth map, px   focal length px (rms px)")
    for side in ("left", "right"):
        files = sorted(folder.glob(f"{side}[0-9]*.jpg"))
        nodes, pixels, scatter = [], [], []
        for file in files:
            try:
                points = find_target(read_image(file), Target("chessboard", 0.03, (9, 6)))
            except CalibrationError as error:
                print(f"    {file.name}: {error}")
                continue
            nodes.append(np.c_[points.node * 0.03, np.zeros(len(points))].astype(np.float32))
            pixels.append(points.pixel.astype(np.float32))
            scatter.append(np.median(points.std))
        rms, matrix, *_ = cv2.calibrateCamera(
            nodes, pixels, (640, 480), None, None, flags=cv2.CALIB_FIX_ASPECT_RATIO
        )
        print(
            f"{side:24s} {len(nodes):3d}/{len(files)}   {np.mean(scatter):30.3f}   "
            f"{matrix[0, 0]:8.2f} ({rms:.3f})"
        )


if __name__ == "__main__":
    cv2.setNumThreads(1)
    shared = Path(sys.argv[1] if len(sys.argv) > 1 else HERE.parents[1] / "shared")
    strings()
    printed()
    real(shared / "data" / "stereo_chessboard")
