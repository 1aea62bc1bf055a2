"""A camera that lies: left out where the others agree, else the nodes are not called measured."""

import numpy as np
import pytest
from measurement_cases import RATE, around

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
    else:  # the first is found by the scores of two pairs alone, the second by their matches as well
        pixels = {"shifted by a pixel": 1, "shifted": 2}[kind]
        frames["cam1"] = [np.roll(image, pixels, axis=1) for image in frames["cam1"]]
    return around(frames, 1)


@pytest.mark.parametrize("kind", ["mirrored", "swapped", "late", "shifted", "shifted by a pixel"])
def test_what_a_lying_camera_spoils_is_not_called_measured(series, geometry, model, kind):
    out = measure(lying(series, kind), geometry, RATE, model)
    truth = series.truth[1]
    measured = series.inside & ((out["quality"][0] & Quality.MEASURED) > 0)
    wrong = np.zeros(measured.shape, bool)
    for name in ("z", "u", "v", "w"):
        wrong |= np.abs(out[name][0] - truth[name]) > 5 * out[f"{name}_std"][0]
    assert (wrong & measured).mean() < 0.01
    if kind in ("mirrored", "late"):  # the others do without it
        assert (out["quality"][0] & Quality.FEWER_CAMERAS).all()
        assert measured[series.inside].mean() > 0.8


def test_a_camera_that_lies_in_a_part_of_its_image_costs_the_nodes_there(series, geometry, model):
    frames = {name: list(images) for name, images in series.frames.items()}
    width = frames["cam1"][0].shape[1] // 3
    for k, image in enumerate(frames["cam1"][1:], 1):
        frames["cam1"][k] = np.hstack([frames["cam1"][0][:, :width], image[:, width:]])
    out = measure(around(frames, 1), geometry, RATE, model)
    quality, truth = out["quality"][0], series.truth[1]
    place = geometry.rig["cam1"].project(
        *np.meshgrid(geometry.grid.x_nodes, geometry.grid.y_nodes), truth["z"]
    )
    spoiled = series.inside & (place[0] < width - 25)
    sound = series.inside & (place[0] > width + 60)
    measured = (quality & Quality.MEASURED) > 0
    assert measured[spoiled].mean() < 0.3 < 0.95 < measured[sound].mean()
    for name in ("z", "u", "v", "w"):
        error = np.abs(out[name][0] - truth[name])
        assert (error > 5 * out[f"{name}_std"][0])[series.inside & measured].mean() < 0.01


@pytest.mark.parametrize("axis", [1, 0])
def test_no_camera_is_accused_where_any_two_of_three_agree(series, geometry, model, axis):
    frames = {name: list(images) for name, images in series.frames.items()}
    frames["cam1"] = [np.roll(image, int(k >= 3), axis=axis) for k, image in enumerate(frames["cam1"])]
    quality = measure(around(frames, 1), geometry, RATE, model)["quality"][0][series.inside]
    accused = (quality & (Quality.WITHOUT_1 | Quality.WITHOUT_2 | Quality.WITHOUT_3)) > 0
    if axis == 1:
        assert not accused.any()
        assert not (quality & Quality.MEASURED).any()
    else:
        assert ((quality & Quality.WITHOUT_1) > 0).all()
        assert not (quality & (Quality.WITHOUT_2 | Quality.WITHOUT_3)).any()
