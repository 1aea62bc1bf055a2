"""Beads at several depths scatter along the sight lines, noise does not: a remark states it."""

import pytest

from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Model, Settings, learn
from wavefield.measurement.height_scatter import height_scatter
from wavefield.measurement.searched import search_widened
from wavefield.quality.field_remarks import MAX_HEIGHT_SCATTER, remark_on_scattered_heights
from wavefield.tank import Scene, Tank


@pytest.mark.parametrize(("submerged", "remarks"), [(0.0, 0), (0.35, 1)])
def test_beads_under_the_water_have_a_remark(submerged, remarks):
    grid = {"x": (-0.16, 0.16), "y": (-0.12, 0.12), "step": 0.01}
    scene = Scene.load("demo").with_(
        rig={"crop": 0.2}, grid=grid, surface={"submerged": submerged}, sea={"kind": "still"}, seed=5
    )
    tank = Tank(scene)
    pair = tank.render(0), tank.render(1)
    geometry = search_widened([pair], GridGeometry(tank.rig, Grid(**grid), Settings()))
    model = Model(geometry, learn([pair], geometry))
    scatter = height_scatter(pair[0], geometry, model, {})
    assert len(list(remark_on_scattered_heights(scatter))) == remarks
    assert abs(scatter / MAX_HEIGHT_SCATTER - 1.0) > 0.2, "not by chance"
