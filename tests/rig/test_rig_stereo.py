import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rig_cases import field, random_camera

from wavefield.rig.stereo import triangulate


def seen(cameras, x, y, z):
    apparent = np.stack([np.stack(c.unproject(*c.project(x, y, z))) for c in cameras])
    sight = np.stack([np.stack(c.sight_line(*p)) for c, p in zip(cameras, apparent)])
    return apparent, sight


@given(st.integers(0, 10_000))
def test_a_point_seen_by_two_cameras_is_found(seed):
    cameras = random_camera(seed), random_camera(seed + 1)
    x, y, z = field(seed, 20)
    p, D = seen(cameras, x, y, z)
    got = triangulate(p, D)
    for found, true in zip(got[:3], (x, y, z)):
        assert abs(found - true).max() < 1e-9
    assert abs(got[3]).max() < 1e-10


def test_a_camera_that_does_not_see_a_point_is_left_out():
    cameras = [random_camera(s) for s in (1, 2, 3)]
    x, y, z = field(1, 3)
    p, D = seen(cameras, x, y, z)
    p[0, :, 0] = np.nan
    p[:2, :, 1] = np.nan
    got = triangulate(p, D)
    assert got[2][[0, 2]] == pytest.approx(z[[0, 2]])
    assert np.isnan(got[2][1])
    assert np.isnan(got[3][0, :, 0]).all()
