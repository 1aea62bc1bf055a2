"""Beads at several depths scatter along the sight lines, noise does not: a remark states it."""

import numpy as np
import pytest

from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Model, Settings, learn
from wavefield.measurement.height_scatter import height_scatter
from wavefield.measurement.searched import search_widened
from wavefield.quality.field_remarks import (
    LEAST_HEIGHT_MOMENT,
    MAX_HEIGHT_SCATTER,
    remark_on_scattered_heights,
)
from wavefield.tank import Scene, Tank

GRID = {"x": (-0.16, 0.16), "y": (-0.12, 0.12), "step": 0.01}
FINE = {"crop": 0.2}
SEAS = {"kind": "still"}, {"rms": 0.004, "shortest": 0.08, "period": 2.0}


def scatter(seed, submerged, sea, rig=FINE, grid=GRID, **surface):
    beads = {"submerged": submerged} | surface
    scene = Scene.load("demo").with_(rig=rig, grid=grid, surface=beads, sea=sea, seed=seed)
    tank = Tank(scene)
    pair = tank.render(0), tank.render(1)
    geometry = search_widened([pair], GridGeometry(tank.rig, Grid(**grid), Settings()))
    return height_scatter(pair[0], geometry, Model(geometry, learn([pair], geometry)), {})


@pytest.mark.parametrize(("submerged", "remarks"), [(0.0, 0), (0.35, 1)])
def test_beads_under_the_water_have_a_remark(submerged, remarks):
    variance, third_moment = scatter(5, submerged, SEAS[0])
    assert len(list(remark_on_scattered_heights(variance, third_moment))) == remarks
    assert abs(variance / MAX_HEIGHT_SCATTER - 1.0) > 0.2, "not by chance"


@pytest.mark.parametrize("sea", SEAS, ids=["still", "waves"])
def test_few_beads_under_the_water_are_lower_than_those_around_and_sound_seas_are_even(sea):
    even, few = (np.array([scatter(seed, part, sea) for seed in (6, 7, 8)]) for part in (0.0, 0.07))
    assert (few[:, 1] < 1.5 * LEAST_HEIGHT_MOMENT).all()
    assert (np.abs(even[:, 1]) < -0.8 * LEAST_HEIGHT_MOMENT).all()
    assert all(list(remark_on_scattered_heights(*one)) for one in few)
    assert not any(list(remark_on_scattered_heights(*one)) for one in even)


def test_sound_seas_with_the_least_noise_have_no_remark():
    coarse = {"scale": 0.5, "crop": 0.4}, {"x": (-0.3, 0.3), "y": (-0.24, 0.24), "step": 0.02}
    alike = {"density": 3000.0, "spread_between": 0.0}  # beads as bright in all cameras: little is noise
    found = [scatter(seed, 0.0, SEAS[0], *coarse, **alike) for seed in (6, 10, 13)]  # worst of twelve
    assert not list(remark_on_scattered_heights(*np.median(found, axis=0)))
