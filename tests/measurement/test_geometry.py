import numpy as np
import pytest

from wavefield.errors import ExperimentError, RigError
from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Settings
from wavefield.rig import Camera, Rig, common_field
from wavefield.tank import paper_rig

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


def test_cameras_left_over_pair_up_when_the_reference_is_missing(rig):
    geometry = GridGeometry(rig, GRID)
    assert geometry.pairs_for(("cam3", "cam1")) == (("cam3", "cam1"),)
    assert geometry.pairs_for(("cam1", "cam2")) == (("cam1", "cam2"),)
    assert geometry.pairs_for(("cam2",)) == ()


def test_a_sharper_camera_is_binned_and_blurred_until_beads_look_alike():
    geometry = GridGeometry(paper_rig(1.0, crop=0.3), GRID)
    assert [geometry.sights[name].binning for name in ("cam1", "cam2", "cam3")] == [1, 1, 2]
    blur = {name: geometry.views[name].blur for name in ("cam1", "cam3")}
    assert blur["cam3"][0] == pytest.approx(0.8, abs=0.2)  # along x, where the others look obliquely
    assert blur["cam1"][1] == pytest.approx(0.6, abs=0.2)  # along y binned pixels are the widest
    assert max(blur["cam3"][1], blur["cam1"][0]) < 0.3


def at_sea(seed):
    """Two cameras side by side, the horizon in both of their images, heights and lenses at random."""
    rng = np.random.default_rng(seed)
    height, down = rng.uniform(2.0, 12.0), np.radians(rng.uniform(6.0, 16.0))
    focal = 500 * rng.uniform(1.2, 2.0)
    cameras = {}
    for name, x in (("left", 0.0), ("right", rng.uniform(0.1, 0.25) * height)):
        roll = np.radians(rng.uniform(-3.0, 3.0))
        facing = np.array([[1, 0, 0], [0, -np.sin(down), -np.cos(down)], [0, np.cos(down), -np.sin(down)]])
        turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
        R = turn @ facing
        cameras[name] = Camera(focal, focal, 320, 240, R, -R @ np.array([x, 0.0, height]), (640, 480))
    return Rig(cameras), height


@pytest.mark.parametrize("seed", range(2))
def test_a_horizon_in_view_does_not_flatten_what_is_measured(seed):
    rig, height = at_sea(seed)
    assert not all(np.isfinite(camera.corners()).all() for camera in rig.cameras.values())
    near = common_field(rig.cameras.values(), step=0.1 * height)
    far = Grid((-10 * height, 10 * height), (8 * height, 12 * height), 0.25 * height)  # beyond its bound
    for grid in (near, far):
        geometry = GridGeometry(rig, grid, Settings(z_range=(-0.02 * height, 0.02 * height)))
        assert max(geometry.plane.shape) < 4000
        x, y = geometry.plane.x, geometry.plane.y
        seen = np.logical_and.reduce([c.sees(geometry.x, geometry.y, 0.0) for c in rig.cameras.values()])
        assert seen.any()
        assert x[0] <= geometry.x[seen].min()
        assert geometry.x[seen].max() <= x[-1]
        assert y[0] <= geometry.y[seen].min()
        assert geometry.y[seen].max() <= y[-1]
        for pair in geometry.pairs:
            searched = geometry.stereo_settings(pair)
            assert np.isfinite([*searched.search_x, *searched.search_y]).all()
