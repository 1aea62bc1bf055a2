import numpy as np
import pytest
from measurement_cases import RATE

from wavefield.measurement import Model, learn, measure
from wavefield.tank import Scene, Tank
from wavefield.variables import FrameStatus, Quality


@pytest.mark.parametrize("seed", range(2))
def test_of_waves_far_above_the_sampled_ones_no_node_is_certain_and_wrong(series, geometry, seed):
    height = 0.008 * 10.0 ** -np.random.default_rng(seed).uniform(0.0, 3.0)
    scene = Scene.load("demo").with_(
        seed=seed, rig={"crop": 0.22}, frames=4, sea={"shortest": 0.2, "rms": height, "period": 4.0}
    )
    tank = Tank(scene)
    images = [tank.render(k) for k in range(4)]
    record = learn([(images[k], images[k + 1]) for k in range(3)], geometry)
    out = measure(series.block(), geometry, RATE, Model(geometry, record))
    measured = series.inside & ((out["quality"][0] & Quality.MEASURED) > 0)
    for name in ("z", "u", "v", "w"):
        wrong = np.abs(out[name][0] - series.truth[0][name]) > 5 * out[f"{name}_std"][0]
        assert (wrong & measured).sum() < 0.02 * series.inside.sum(), (height, name)
    if height < 4e-4:
        assert (out["quality"][0][series.inside] & Quality.REJECTED_RANGE).all()
        assert out["frame_status"][0] == FrameStatus.FAILED
        assert np.isnan(out["z"]).all()
