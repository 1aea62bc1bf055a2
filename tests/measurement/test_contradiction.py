"""A camera that lies: left out where the others agree, else the nodes are not called measured."""

import numpy as np
import pytest
from measurement_cases import RATE

from wavefield.measurement import measure
from wavefield.variables import Quality


def lying(series, kind):
    frames = {name: list(images) for name, images in series.frames.items()}
    if kind == "mirrored":
        frames["cam1"] = [image[:, ::-1].copy() for image in frames["cam1"]]
    elif kind == "swapped":
        frames["cam1"], frames["cam2"] = frames["cam2"], frames["cam1"]
    elif kind == "late":
        frames["cam1"] = [frames["cam1"][0], *frames["cam1"][:-1]]
    else:
        frames["cam1"] = [np.roll(image, 2, axis=1) for image in frames["cam1"]]
    return {name: images[1:5] for name, images in frames.items()}


@pytest.mark.parametrize("kind", ["mirrored", "swapped", "late", "shifted"])
def test_what_a_lying_camera_spoils_is_not_called_measured(series, plan, kind):
    out = measure(lying(series, kind), plan, RATE)
    truth = series.truth[1]
    measured = series.inside & ((out["quality"][0] & Quality.MEASURED) > 0)
    wrong = np.zeros(measured.shape, bool)
    for name in ("z", "u", "v", "w"):
        wrong |= np.abs(out[name][0] - truth[name]) > 5 * out[f"{name}_std"][0]
    assert (wrong & measured).mean() < 0.01
    if kind in ("mirrored", "late"):  # the others do without it
        assert (out["quality"][0] & Quality.FEWER_CAMERAS).all()
        assert measured[series.inside].mean() > 0.8


def test_cameras_that_tell_the_truth_are_not_accused(series, plan):
    out = measure({name: images[1:5] for name, images in series.frames.items()}, plan, RATE)
    assert not (out["quality"][0] & Quality.FEWER_CAMERAS).any()
    assert ((out["quality"][0] & Quality.MEASURED) > 0)[series.inside].mean() > 0.99
