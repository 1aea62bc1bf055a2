import numpy as np
import pytest

from wavefield.errors import ExperimentError, RigError
from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Settings
from wavefield.rig import Rig, common_field
from wavefield.tank import Scene, paper_rig

GRID = Grid(x=(-0.1, 0.1), y=(-0.08, 0.08), step=0.01)


@pytest.fixture(scope="module")
def rig():
    return paper_rig(0.5, crop=0.4)


def renamed(rig, **names):
    return Rig({new: rig[old] for new, old in names.items()})


def test_the_middle_camera_is_the_reference_whatever_its_name(rig):
    geometry = GridGeometry(renamed(rig, left="cam1", top="cam3", right="cam2"), GRID)
    assert geometry.pairs == (("top", "left"), ("top", "right"))
    assert geometry.velocity_cameras == ("left", "top", "right")
    assert GridGeometry(Rig({n: rig[n] for n in ("cam1", "cam2")}), GRID).pairs == (("cam1", "cam2"),)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (Settings(pairs=(("cam1", "cam9"),)), "no camera 'cam9'"),
        (Settings(velocity_cameras=("cam1", "cam7")), "no camera 'cam7'"),
        (Settings(pairs=(("cam1", "cam2"), ("cam1", "cam2"))), "share one camera"),
        (Settings(pairs=(("cam1", "cam2"), ("cam2", "cam3"), ("cam3", "cam1"))), "share one camera"),
    ],
)
def test_wrong_cameras_are_named(rig, settings, message):
    with pytest.raises(ExperimentError, match=message):
        GridGeometry(rig, GRID, settings)


def test_a_grid_that_no_two_cameras_see_is_refused(rig):
    for x in (5.0, -1e6):
        with pytest.raises(RigError, match="does the grid lie in"):
            GridGeometry(rig, Grid(x=(x, x + 0.2), y=(-0.1, 0.1), step=0.01))
    with pytest.raises(RigError, match="at least two"):
        GridGeometry(Rig({"cam1": rig["cam1"]}), GRID)


def test_a_sharper_camera_is_binned_and_blurred_until_beads_look_alike():
    geometry = GridGeometry(paper_rig(1.0, crop=0.3), GRID)
    assert [geometry.sights[name].binning for name in ("cam1", "cam2", "cam3")] == [1, 1, 2]
    blur = {name: geometry.views[name].blur for name in ("cam1", "cam3")}
    assert blur["cam3"][0] == pytest.approx(0.8, abs=0.2)  # along x, where the others look obliquely
    assert blur["cam1"][1] == pytest.approx(0.6, abs=0.2)  # along y binned pixels are the widest
    assert max(blur["cam3"][1], blur["cam1"][0]) < 0.3


def test_a_horizon_in_view_does_not_flatten_what_is_measured():
    rig = Scene.load("sea").build_rig()
    for grid in (common_field(rig.cameras.values(), step=1.2), Grid((-120, 120), (96, 144), 3.0)):
        geometry = GridGeometry(rig, grid, Settings(z_range=(-0.24, 0.24)))
        seen = np.logical_and.reduce([c.sees(geometry.x, geometry.y, 0.0) for c in rig.cameras.values()])
        lattice = geometry.lattice
        for plane, nodes in ((lattice.x, geometry.x[seen]), (lattice.y, geometry.y[seen])):
            assert plane[0] <= nodes.min() < nodes.max() <= plane[-1]
