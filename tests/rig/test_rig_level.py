import numpy as np
import pytest
from rig_cases import random_camera

from wavefield.errors import RigError
from wavefield.rig import Rig
from wavefield.rig.water_level import level


@pytest.fixture
def rig():
    return Rig({f"cam{k}": random_camera(k) for k in (1, 2, 3)}, {"date": "today"})


def tilted(n=400, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-0.5, 0.5, (2, n))
    return x, y, 0.03 + 0.02 * x - 0.01 * y + noise * rng.normal(size=n)


def test_too_few_points_and_a_line_of_points_are_refused(rig):
    x, y, z = tilted(9)
    with pytest.raises(RigError, match="ten at least"):
        level(rig, x, y, z)
    x = np.linspace(0, 1, 50)
    with pytest.raises(RigError, match="line"):
        level(rig, x, 2 * x, 0 * x)


def test_a_rig_in_a_cameras_own_frame_is_levelled_however_it_is_tilted(rig):
    x, y, z = tilted(noise=2e-4)
    z[::9] += 0.3  # blunders
    first = rig["cam1"]
    own = rig.moved(first.R.T, first.centre)  # as other programs have it: z along the first camera's view
    seen = first.R @ np.stack([x, y, z]) + first.T[:, None]
    flat, plane = level(own, *seen)
    assert flat.provenance["levelled"]["tilt_deg"] > 90
    assert plane.rms == pytest.approx(2e-4, rel=0.15)
    assert all(flat[name].centre[2] > 2 for name in flat)
    inside = np.ones(len(x), bool)
    inside[::9] = False
    for name in flat:  # the water's points are seen where they are, at z = 0
        X, Y = rig[name].project(x[inside], y[inside], z[inside])
        again = np.stack([*flat[name].unproject(X, Y), np.zeros(inside.sum())])
        miss = np.hypot(*(np.stack(flat[name].project(*again)) - [X, Y]))
        assert miss.max() < 1e-6
    apart = flat["cam2"].unproject(*rig["cam2"].project(x[inside], y[inside], z[inside]))
    same = flat["cam3"].unproject(*rig["cam3"].project(x[inside], y[inside], z[inside]))
    assert np.sqrt(np.mean(np.subtract(apart, same) ** 2)) < 3e-4
