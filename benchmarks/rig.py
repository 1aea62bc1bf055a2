"""Exactness and speed of the geometry: `python -m benchmarks.rig` prints asked and reached.

The files of other programs are read from the folder that WAVEFIELD_SHARED names, or ../shared; without it
their lines are skipped.
"""

import csv
import os
import sys
import tempfile
import time
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import cv2
import mpmath
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "rig"))
from rig_cases import field, random_camera
from test_rig_camera import project_in_50_digits

from wavefield.rig import common_field
from wavefield.rig.epipolar import epipolar_distance
from wavefield.rig.formats import load_rig, save_uvmat
from wavefield.rig.stereo import jacobians, solve_displacement, triangulate
from wavefield.tank.rigs import paper_rig

cv2.setNumThreads(1)
SHARED = Path(os.environ.get("WAVEFIELD_SHARED", Path(__file__).resolve().parents[2] / "shared")) / "data"


def row(what, asked, reached, unit):
    limit = "" if asked is None else f"{asked:g}"
    verdict = "" if asked is None else ("reached" if reached <= asked else "NOT REACHED")
    print(f"{what:<66} {limit:>8} {reached:>10.3g} {unit:<6} {verdict}")


def least_time(task, repeats=50):
    """Shortest CPU time of several runs, ms."""
    best = np.inf
    for _ in range(repeats):
        begin = time.process_time()
        task()
        best = min(best, time.process_time() - begin)
    return 1e3 * best


def exactness():
    worst = back = slope = 0.0
    for seed in range(40):
        camera = random_camera(seed, "skew")
        x, y, z = field(seed)
        K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        turn, D = cv2.Rodrigues(camera.R)[0], camera.D
        ref = cv2.projectPoints(np.stack([x, y, z], -1), turn, camera.T, K, D)[0][:, 0]
        worst = max(worst, np.abs(np.stack(camera.project(x, y, z), -1) - ref).max())
        camera = random_camera(seed)
        X, Y = np.random.default_rng(seed).uniform(0, 1023, (2, 500))
        again = camera.project(*camera.unproject(X, Y, 0.03), 0.03)
        back = max(back, np.abs(again[0] - X).max(), np.abs(again[1] - Y).max())
    for seed in range(5):
        camera = random_camera(seed)
        for point in np.stack(field(seed, 5), -1):
            J = camera.jacobian(*point)
            with mpmath.workdps(50):
                h = mpmath.mpf(10) ** -20
                for j in range(3):
                    lo, hi = ([mpmath.mpf(v) for v in point] for _ in range(2))
                    lo[j], hi[j] = lo[j] - h, hi[j] + h
                    a, b = project_in_50_digits(camera, *lo), project_in_50_digits(camera, *hi)
                    exact = np.array([float((b[i] - a[i]) / (2 * h)) for i in range(2)])
                    slope = max(slope, np.abs(J[:, j] - exact).max() / np.abs(J).max())
    row("project against cv2.projectPoints, 40 cameras with all terms", 1e-9, worst, "px")
    row("pixel -> plane -> pixel, 40 cameras with all terms", 1e-9, back, "px")
    row("Jacobian against 50-digit differences, relative", 1e-8, slope, "")


def speed():
    rng = np.random.default_rng(0)
    x, y, z = rng.uniform(-0.5, 0.5, (3, 30_000))
    for label, camera in (("the paper's model", paper_rig()["cam3"]), ("all terms", random_camera(1))):
        took = least_time(lambda camera=camera: camera.project(x, y, z))
        row(f"project 30,000 points, one camera, {label}, CPU", 3.0, took, "ms")
    cameras = [random_camera(s) for s in (1, 2, 3)]
    row(
        "Jacobian at 30,000 points, all terms, CPU",
        None,
        least_time(lambda: cameras[0].jacobian(x, y, z)),
        "ms",
    )
    J = jacobians(cameras, x, y, z)
    seen = rng.normal(size=(30_000, 6))
    std = np.full((30_000, 6), 0.05)
    took = least_time(lambda: solve_displacement(J[:, :4], seen[:, :4], std[:, :4]))
    row("2N x 3 solve with eps_piv and std, 2 cameras, 30,000 nodes, CPU", None, took, "ms")
    row("the same, 3 cameras", None, least_time(lambda: solve_displacement(J, seen, std)), "ms")
    apparent, sight = rng.normal(size=(2, 3, 2, 30_000))
    took = least_time(lambda: triangulate(apparent[:2], sight[:2]))
    row("points seen by 2 cameras, 30,000 nodes, CPU", None, took, "ms")
    row("the same, 3 cameras", None, least_time(lambda: triangulate(apparent, sight)), "ms")
    rig = paper_rig()
    row(
        "common field of the paper's rig, CPU",
        None,
        least_time(lambda: common_field(rig.cameras.values()), 3),
        "ms",
    )


def other_programs():
    if not SHARED.is_dir():
        print(f"no files of other programs in {SHARED}: skipped")
        return
    rig = load_rig(SHARED / "d_specimen" / "cal.xml")
    with open(SHARED / "d_specimen" / "reference" / "DICe_solution_0.txt") as file:
        rows = [r for r in csv.DictReader(file) if float(r["MATCH"]) == 0]
    keys = ("COORDINATE_X", "COORDINATE_Y", "CROSS_CORR_Q", "CROSS_CORR_R")
    X, Y, q, r = np.array([[float(line[key]) for key in keys] for line in rows]).T
    distance = epipolar_distance(rig["cam1"], rig["cam2"], X, Y, X + q, Y + r)
    row(
        f"VIC-3D calibration, epipolar residual of {len(X)} matches, median",
        0.13,
        np.median(abs(distance)),
        "px",
    )
    size = {"PCO_top": (2560, 2160)}
    first = load_rig(SHARED / "piv_samples" / "Milestone" / "PCO_top.xml", sizes=size)["PCO_top"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "PCO_top.xml"
        save_uvmat(first, path)
        second = load_rig(path, sizes=size)["PCO_top"]
    worst = 0.0
    for key, value in first.to_dict().items():
        a, b = np.asarray(value, float), np.asarray(second.to_dict()[key], float)
        worst = max(worst, np.abs(a - b).max() / max(1.0, np.abs(a).max()))
    row("UVMAT XML import, export, import: largest relative difference", 1e-12, worst, "")


if __name__ == "__main__":
    print(f"{'':<66} {'asked':>8} {'reached':>10}")
    exactness()
    speed()
    other_programs()
