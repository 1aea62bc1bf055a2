"""Accuracy on the random sea beside the Cramer-Rao bound: `python -m benchmarks.measurement --bound`.

The bound is that of an unbiased estimate from the two frames of a step: of z in the middle of the step and of
the displacement, where every independent area of the surface has a texture of its own, which is unknown and
common to all cameras and both frames, and images have white noise. An independent area is lambda^2 / pi, for
a field of all waves longer than lambda, the shortest wave of the sea. The measurement uses more frames and
the spectrum of the waves, so that it may fall below this bound.
"""

import numpy as np
from numpy.typing import NDArray

from benchmarks.results import print_table, save_result
from benchmarks.scenes import PIXEL, calibrated, draw, reconstruct, scene
from benchmarks.scores import NAMES, Score
from wavefield.measurement import Settings
from wavefield.tank import Scene, Tank

SHORTEST = 0.05  # m, of the random sea
DARK = {"read_noise": 0.0, "shot_noise": 0.0}
# a rule of VIC-3D's makers: field / 100,000 in the plane and field / 50,000 out of it
RULE = {"z": 50_000, "u": 100_000, "v": 100_000, "w": 50_000}
COLUMNS = ("", "error, px", "Cramer-Rao bound, px", "error over bound", "VIC-3D's rule, px")


def bound(described: Scene) -> NDArray[np.float64]:
    """Standard deviations of z in the middle of a step and of the displacement, metres, (4,)."""
    noisy, exact = Tank(described).render(3), Tank(described.with_(light=DARK)).render(3)
    known, mean, weights = np.zeros((4, 4)), np.zeros((2, 4)), 0.0
    gradients = []
    shifts, weight = [], []
    for name, camera in Tank(described).rig.cameras.items():
        image = np.asarray(exact[name], float)
        variance = float(np.var(np.asarray(noisy[name], float) - image))
        slopes = np.stack(np.gradient(image)[::-1]).reshape(2, -1)  # along columns, rows
        J = camera.jacobian(0.0, 0.0, 0.0)
        plane, rise = J[:, :2], J[:, 2]
        gradients.append(plane.T @ (slopes @ slopes.T / slopes.shape[1]) @ plane)
        parallax = np.linalg.solve(plane, rise)
        for frame in (0, 1):  # by how much z, dx, dy, dz move the texture in the plane
            shifts.append(np.column_stack([parallax, frame * np.eye(2), frame * parallax]))
            weight.append(abs(np.linalg.det(plane)) / variance)  # pixels per m2 over the noise
    G = np.mean(gradients, axis=0)
    for S, w in zip(shifts, weight, strict=True):
        known += w * S.T @ G @ S
        mean += w * S
        weights += w
    information = known - mean.T @ G @ mean / weights  # the texture itself is unknown
    covariance = np.linalg.inv(information * SHORTEST**2 / np.pi)
    middle = np.eye(4)
    middle[0, 3] = 0.5
    return np.sqrt(np.diag(middle @ covariance @ middle.T))


def show(seeds: list[int], save: bool) -> None:
    """Print the errors of the random sea, their bounds and the rule."""
    score = Score()
    for seed in seeds:
        case = draw(scene("random", seed), calibrated())
        score.add(case, reconstruct(case, Settings()))
    least = bound(scene("random", seeds[0])) / PIXEL
    field = np.ptp(case.grid.x_nodes) / PIXEL
    rows = []
    for name, limit in zip(NAMES, least, strict=True):
        label = name if name == "z" else f"{name} dt"
        error, rule = score.rms(name), field / RULE[name]
        rows.append([label, f"{error:.3f}", f"{limit:.3f}", f"{error / limit:.1f}", f"{rule:.3f}"])
    print_table(COLUMNS, rows)
    if save:
        save_result("bound", COLUMNS, rows)
