import numpy as np
from measurement_cases import RATE

from wavefield.measurement import measure
from wavefield.variables import Quality


def test_a_camera_moved_by_one_pixel_in_half_its_picture_is_left_out_there(series, geometry, model):
    frames = series.block(1)
    half = frames["cam1"][0].shape[1] // 2
    moved = [np.hstack([np.roll(image, 1, axis=1)[:, :half], image[:, half:]]) for image in frames["cam1"]]
    out = measure(frames | {"cam1": moved}, geometry, RATE, model)
    measured = (out["quality"][0] & Quality.MEASURED) > 0
    wrong = np.abs(out["z"][0] - series.truth[1]["z"]) > 5 * out["z_std"][0]
    assert 0.3 < measured[series.inside].mean() < 0.7
    assert (wrong & measured)[series.inside].mean() < 0.01
    assert wrong[series.inside].mean() > 0.2  # it does harm where it is not measured
