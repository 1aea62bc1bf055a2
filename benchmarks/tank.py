"""How exact the truth of the simulated tank is, and how fast it draws: `python -m benchmarks.tank`.

Times are CPU seconds of one thread (the least of several), so that a busy machine does not change them much.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import tempfile
import time
from pathlib import Path

import numpy as np

from wavefield.tank import Scene, Tank, simulate
from wavefield.tank.beads import carry
from wavefield.tank.truth import displacement


def least(function, *rounds):
    """CPU seconds of the quickest round."""
    times = []
    for argument in rounds:
        start = time.process_time()
        function(argument)
        times.append(time.process_time() - start)
    return min(times)


def exactness():
    """Errors of the truth, on the steep sea with bound waves."""
    tank = Tank(Scene.load("steep"))
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.7, 0.7, (2, 4000))
    f = tank.sea.at(x, y, 1.3)
    yield (
        "kinematic condition, steep sea, m/s",
        "1e-12",
        f"{np.abs(f['w'] - f['z_t'] - f['u'] * f['z_x'] - f['v'] * f['z_y']).max():.1e}",
    )
    (z,) = tank.basin.snapshot(1.3)(x, y)
    yield "bead off the surface, largest, um", "0.1", f"{1e6 * np.abs(z - f['z']).max():.4f}"
    dt = 0.05
    ax, ay = carry(tank.basin, x, y, 1.3, 1.3 + dt)
    bx, by = x, y
    for i in range(16):
        bx, by = carry(tank.basin, bx, by, 1.3 + i * dt / 16, 1.3 + (i + 1) * dt / 16)
    yield "bead off its path after a frame, largest, um", "1", f"{1e6 * np.hypot(ax - bx, ay - by).max():.4f}"
    dx, dy, _ = displacement(tank.basin, x, y, 1.3, dt)
    px, py = carry(tank.basin, x - dx / 2, y - dy / 2, 1.3 - dt / 2, 1.3 + dt / 2)
    error = np.hypot(px - x - dx / 2, py - y - dy / 2).max()
    yield "true displacement off, largest, um", "1", f"{1e6 * error:.4f}"


def centroids():
    """Distance of spots' centroids from the camera's projection, without noise."""
    quiet = {"read_noise": 0, "shot_noise": 0, "unevenness": 0, "background": 0, "bits": 16}
    tank = Tank(Scene.load("demo").with_(light=quiet, surface={"density": 900, "one_camera": 0}))
    beads, images, errors = tank.population.frame(1), tank.render(1), []
    d = np.arange(-5, 6)
    for name, camera in tank.rig.cameras.items():
        X, Y = camera.project(beads.x, beads.y, beads.z)
        apart = np.hypot(X[:, None] - X, Y[:, None] - Y) + 1e9 * np.eye(X.size)
        lone = (apart.min(axis=1) > 14) & camera.sees(beads.x, beads.y, beads.z, 8)
        for x, y in zip(X[lone], Y[lone], strict=True):
            i, j = round(y), round(x)
            patch = images[name][i - 5 : i + 6, j - 5 : j + 6].astype(float)
            errors.append(
                (j + (patch * d).sum() / patch.sum() - x, i + (patch.T * d).sum() / patch.sum() - y)
            )
    errors = np.array(errors)
    yield f"centroid of a spot, largest of {len(errors)}, px", "0.01", f"{np.abs(errors).max():.4f}"


def speed():
    """Drawing times at full size, and a whole demo."""
    full = Tank(Scene.load("full"))
    full.render(0)
    yield (
        "a step of three full-size cameras, beads followed, s",
        "3",
        f"{least(full.render, 1, 2, 3, 4):.2f}",
    )
    yield "exact fields and displacements, 2 x 1.5 m, s", "", f"{least(full.truth, 1, 2, 3):.2f}"
    names = list(full.rig)
    drawn = least(lambda pose: [full.target_image(pose, name) for name in names], "flat", "tilt_1", "tilt_2")
    yield "a pose of the target, three full-size cameras, s", "", f"{drawn:.2f}"
    painted = Tank(Scene.load("texture").with_(rig={"scale": 1.0}))
    yield "texture, three full-size cameras, s", "", f"{least(painted.render, 0, 1):.2f}"
    with tempfile.TemporaryDirectory() as folder:
        start = time.process_time()
        simulate(Scene.load("demo"), Path(folder) / "demo")
        yield "`wavefield simulate demo`, whole, s", "60", f"{time.process_time() - start:.1f}"


def main():
    rows = [*exactness(), *centroids(), *speed()]
    print("| figure | asked | reached |\n|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
