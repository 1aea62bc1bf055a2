"""Simulated views of a plane target by the paper's cameras, for the tests of the solving half."""

import numpy as np

from wavefield.calibration.points import TargetPoints
from wavefield.tank.rigs import paper_rig

MESH = 0.10
TILTS = [(25, 0), (-25, 0), (0, 25), (0, -25), (18, 18), (-18, 18)]


def poses(seed=0, tilts=TILTS):
    """Target to world: tilted about x and y (degrees), turned and shifted a little; and flat."""
    rng = np.random.default_rng(seed)
    out = {}
    for k, (ax, ay) in enumerate(tilts):
        a, b, c = np.radians([ax, ay, rng.uniform(-15, 15)])
        Rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        Ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        Rz = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
        out[f"tilt_{k}"] = Rz @ Ry @ Rx, rng.uniform(-0.1, 0.1, 3)
    out["flat"] = np.eye(3), np.zeros(3)
    return out


def nodes(nx=21, ny=17):
    i, j = np.meshgrid(np.arange(nx) - nx // 2, np.arange(ny) - ny // 2, indexing="ij")
    return np.stack([i.ravel(), j.ravel()], axis=-1)


def views(rig=None, seed=0, noise=0.005, where=None, offsets=None, mesh=MESH, std=None):
    """What each camera of the rig sees of each pose."""
    rig = paper_rig() if rig is None else rig
    rng = np.random.default_rng(seed + 100)
    grid = nodes()
    plan = np.column_stack([grid * mesh, np.zeros(len(grid))])
    if offsets is not None:
        plan = plan + offsets
    out = {}
    for name in rig:
        camera = rig[name]
        out[name] = {}
        for pose, (R, t) in (poses(seed) if where is None else where).items():
            world = plan @ R.T + t
            seen = camera.sees(*world.T, margin=5)
            pixel = np.stack(camera.project(*world[seen].T), -1) + noise * rng.normal(size=(seen.sum(), 2))
            out[name][pose] = TargetPoints(
                grid[seen], pixel, np.full(seen.sum(), std or max(noise, 1e-4)), camera.size
            )
    return out
