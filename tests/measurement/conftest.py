"""A small piece of the tank at full resolution: images of beads on a random sea, and the exact answer."""

import numpy as np
import pytest
from measurement_cases import Series

from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Model, learn
from wavefield.tank import Scene, Tank


@pytest.fixture(scope="session")
def series() -> Series:
    scene = Scene.load("demo").with_(
        rig={"crop": 0.22}, frames=6, sea={"shortest": 0.2, "rms": 0.008, "period": 4.0}
    )
    tank = Tank(scene)
    images = [tank.render(k) for k in range(6)]
    grid = Grid(x=(-0.18, 0.18), y=(-0.14, 0.14), step=0.01)
    x, y = np.meshgrid(grid.x_nodes, grid.y_nodes)
    truth = []
    for step in range(3):
        names = ("z", "z_x", "z_y", "z_t", "u", "v")
        values = tank.basin.snapshot(tank.time(step + 1.5), names)(x, y)
        fields = dict(zip(names, values))
        fields["w"] = fields["z_t"] + fields["u"] * fields["z_x"] + fields["v"] * fields["z_y"]
        truth.append(fields)
    inside = (np.abs(x) <= 0.14) & (np.abs(y) <= 0.10)
    frames = {name: [image[name] for image in images] for name in tank.rig}
    return Series(tank.rig, grid, frames, truth, inside)


@pytest.fixture(scope="session")
def geometry(series: Series) -> GridGeometry:
    return GridGeometry(series.rig, series.grid)


@pytest.fixture(scope="session")
def model(series: Series, geometry: GridGeometry) -> Model:
    steps = [tuple({n: f[k + i] for n, f in series.frames.items()} for i in (0, 1)) for k in range(4)]
    record = learn(steps, geometry)
    assert record is not None
    return Model(geometry, record)
