"""A camera that lies: left out where the others agree, else the nodes are not called measured."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from measurement_cases import RATE, around

from wavefield.measurement import measure
from wavefield.measurement.instant import look
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
    return around(frames, 1)


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
    out = measure(series.block(1), plan, RATE)
    assert not (out["quality"][0] & Quality.FEWER_CAMERAS).any()
    assert ((out["quality"][0] & Quality.MEASURED) > 0)[series.inside].mean() > 0.99


def test_water_that_stands_where_none_was_searched_is_not_called_measured(series, plan, monkeypatch):
    """Not even where it is only the frame before the step, which has a say in z at mid-time."""

    def look_up(frames, plan, masks=None):
        found = look(frames, plan, masks)
        first = frames["cam1"] is series.frames["cam1"][1]
        z = found.surface.z.copy()
        z[10, 12] += 0.5 if first else 0.0
        return replace(found, surface=replace(found.surface, z=z))

    monkeypatch.setattr(sys.modules["wavefield.measurement.measure"], "look", look_up)
    out = measure(series.block(1), plan, RATE)
    measured = (out["quality"][0] & Quality.MEASURED) > 0
    assert series.inside[10, 12]
    assert not measured[10, 12]
    assert measured[10, 13]
    assert out["z_std"][0, 10, 12] > 0.01  # z is off by a sixteenth of half a metre
    assert out["z_std"][0, 10, 13] < 1e-3
