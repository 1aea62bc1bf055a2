import json
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from measurement_cases import PIXEL, RATE, around

from wavefield.errors import ExperimentError
from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Model, Settings, learn, measure
from wavefield.measurement.midtime import slope
from wavefield.measurement.model import LearnedRecord
from wavefield.rig import Rig
from wavefield.variables import CUBE_FIELDS, FrameStatus, Quality


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module")
def cube(series, geometry, model):
    return measure(series.block(steps=3), geometry, RATE, model)


def same(a, b):
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def test_surface_and_velocity_are_those_of_the_water_within_their_uncertainty(series, cube):
    for step, truth in enumerate(series.truth):
        error = {
            name: (cube[name][step] - truth[name])[series.inside] / PIXEL for name in ("z", "u", "v", "w")
        }
        assert rms(error["z"]) < 0.04
        assert rms(error["u"]) / RATE < 0.02
        assert rms(error["v"]) / RATE < 0.02
        assert rms(error["w"]) / RATE < 0.03
        assert rms((cube["z_t"][step] - truth["z_t"])[series.inside]) / PIXEL / RATE < 0.08
    for name in ("z", "u", "v", "w"):
        error = np.abs(np.stack([cube[name][k] - series.truth[k][name] for k in range(3)]))
        assert 0.4 < (error < cube[name + "_std"])[:, series.inside].mean() < 0.95, name


def test_sight_lines_that_miss_each_other_make_z_less_certain(series, geometry, model, cube):
    bent = series.rig.cameras | {"cam1": replace(series.rig["cam1"], cy=series.rig["cam1"].cy + 0.1)}
    other = GridGeometry(Rig(bent), series.grid)
    out = measure(series.block(1), other, RATE, Model(other, model.record))
    more = out["z_std"][0] ** 2 - cube["z_std"][1] ** 2
    assert 0.02 * PIXEL < np.sqrt(np.median(more[series.inside])) < 0.15 * PIXEL


def test_where_the_water_moves_further_than_is_searched_the_run_goes_on_and_reports_it(series):
    piv = replace(Settings().piv, search_x=(40.0, 48.0), search_y=(40.0, 48.0))
    out = measure(series.block(steps=3), GridGeometry(series.rig, series.grid, Settings(piv=piv)), RATE)
    assert not ((out["quality"] & Quality.MEASURED) > 0).any()


def test_water_above_the_elevations_searched_is_marked_as_that(series):
    searched = GridGeometry(series.rig, series.grid, Settings(z_range=(-0.05, 0.004)))
    quality = measure(series.block(steps=1), searched, RATE)["quality"][0]
    z = series.truth[0]["z"]
    marked = (quality & Quality.REJECTED_RANGE) > 0
    assert marked[series.inside & (z > 0.007)].mean() > 0.9
    assert marked[series.inside & (z < 0.0)].mean() < 0.05
    assert not (quality[marked] & Quality.MEASURED).any()


def test_a_record_survives_as_plain_data_and_learning_from_the_frames_at_hand_serves(
    series, geometry, model, cube
):
    again = LearnedRecord.from_dict(json.loads(json.dumps(model.record.to_dict())))
    assert again == model.record
    old = {name: part for name, part in model.record.to_dict().items() if name != "ripples"}
    with pytest.raises(ExperimentError, match="another version"):
        LearnedRecord.from_dict(old)
    alone = measure(series.block(steps=3), GridGeometry(series.rig, series.grid), RATE)
    assert rms((alone["u"] - cube["u"])[:, series.inside]) < 0.01 * PIXEL * RATE


def test_a_step_is_the_same_to_the_bit_in_any_block(series, geometry, model, cube):
    for first in range(3):
        alone = measure(series.block(first), geometry, RATE, model)
        same(alone, {name: field[first : first + 1] for name, field in cube.items()})


def test_the_number_of_threads_changes_no_bit(series, geometry, model, cube):
    before = cv2.getNumThreads()
    cv2.setNumThreads(4)
    try:
        again = measure(series.block(), geometry, RATE, model)
    finally:
        cv2.setNumThreads(before)
    same(again, {name: field[:1] for name, field in cube.items()})


def test_without_a_neighbour_a_parabola_serves_and_is_marked(series, geometry, model, cube):
    frames = series.without(*((name, 0) for name in series.rig))
    out = measure(frames, geometry, RATE, model)
    seen = np.isfinite(out["z"][0])
    assert (out["quality"][0] & Quality.TWO_FRAME_MEAN).all()
    assert not (out["quality"][1:] & Quality.TWO_FRAME_MEAN)[:, series.inside].any()
    assert out["frame_status"][0] == FrameStatus.DONE
    # z of four frames instead of six tilts the surface a little otherwise
    np.testing.assert_allclose(out["z_t"][1:], cube["z_t"][1:], atol=1e-4)
    # a parabola is off by z_ttt dt^3 / 16, which its uncertainty must hold
    error = np.abs(out["z"][0] - series.truth[0]["z"])[series.inside & seen]
    assert 0.2 * PIXEL > rms(error) > rms((cube["z"][0] - series.truth[0]["z"])[series.inside])
    # most of it: waves longer than this field cannot be separated from its mean
    assert (error < 3 * out["z_std"][0][series.inside & seen]).mean() > 0.85


@pytest.mark.parametrize("lost", ["cam1", "cam2", "cam3"])
def test_a_missing_frame_costs_that_camera_only(series, geometry, model, lost):
    # frame 4 belongs to steps 2 and 3 (from 1), and is the neighbour of step 1
    out = measure(series.without((lost, 3)), geometry, RATE, model)
    assert list(out["frame_status"]) == [FrameStatus.DONE] + [FrameStatus.DONE_WITH_FAULTS] * 2
    assert not (out["quality"][0] & Quality.FEWER_CAMERAS).any()
    assert (out["quality"][1:] & Quality.FEWER_CAMERAS).all()
    for step in (1, 2):
        assert np.isfinite(out["z"][step]).mean() > 0.9
        measured = series.inside & ((out["quality"][step] & Quality.MEASURED) > 0)
        assert measured[series.inside].mean() > 0.8
        for name, scale in (("z", 1.0), ("u", RATE), ("v", RATE), ("w", RATE)):
            error = (out[name][step] - series.truth[step][name])[measured] / PIXEL / scale
            assert rms(error) < 0.25, name


@pytest.mark.parametrize(
    "bad",
    [
        lambda image: np.zeros_like(image),
        lambda image: image[:-1],
        lambda image: np.full(image.shape, np.nan, np.float32),
    ],
    ids=["black", "wrong size", "nan"],
)
def test_a_bad_frame_is_as_good_as_none(series, geometry, model, bad):
    frames = {name: list(images[:4]) for name, images in series.frames.items()}
    frames["cam2"][1] = bad(frames["cam2"][1])
    absent = {name: list(images[:4]) for name, images in series.frames.items()}
    absent["cam2"][1] = None
    same(measure(around(frames), geometry, RATE, model), measure(around(absent), geometry, RATE, model))


def test_with_one_camera_left_the_step_fails_and_the_others_do_not(series, geometry, model, cube):
    out = measure(series.without(("cam1", 4), ("cam2", 4)), geometry, RATE, model)
    assert list(out["frame_status"]) == [FrameStatus.DONE, FrameStatus.DONE, FrameStatus.FAILED]
    assert np.isnan(out["z"][2]).all()
    assert np.isnan(out["u"][2]).all()
    np.testing.assert_array_equal(out["z"][0], cube["z"][0])
    # the middle step lacks its neighbour
    assert (out["quality"][1] & Quality.TWO_FRAME_MEAN).all()


def test_no_node_of_a_failed_step_counts_as_measured(series, geometry, model, monkeypatch):
    monkeypatch.setattr(sys.modules["wavefield.measurement.step"], "MIN_MEASURED", 1.1)
    failed = measure(series.block(), geometry, RATE, model)
    assert (failed["frame_status"] == FrameStatus.FAILED).all()
    assert np.isnan(failed["z"]).all()
    assert not (failed["quality"] & Quality.MEASURED).any()
    assert ((failed["quality"] & Quality.FILLED) > 0).mean() > 0.5


def test_two_cameras_far_apart_are_half_as_uncertain_again_as_three_at_most(series, cube):
    pair = Rig({name: series.rig[name] for name in ("cam1", "cam2")})
    frames = {name: images for name, images in series.block(steps=3).items() if name in pair}
    steps = [tuple({n: series.frames[n][k + i] for n in pair} for i in (0, 1)) for k in range(4)]
    plain = GridGeometry(pair, series.grid)
    two = measure(frames, plain, RATE, Model(plain, learn(steps, plain)))
    for name in ("z", "u", "v", "w"):
        errors = [
            np.stack([(out[name][k] - series.truth[k][name])[series.inside] for k in range(3)])
            for out in (two, cube)
        ]
        assert rms(errors[0]) < 1.6 * rms(errors[1])
    assert np.mean((two["quality"] & Quality.MEASURED) != 0) > 0.97


def test_gains_and_flicker_change_little(series, geometry, model, cube):
    gain = {"cam1": (0.4, 0.3, 0.5, 0.35), "cam2": (0.9, 1.0, 0.7, 1.0), "cam3": (1.0, 0.8, 1.0, 0.6)}
    dim = {
        name: [np.round(image * g).astype(np.uint8) for image, g in zip(series.frames[name], gain[name])]
        for name in series.rig
    }
    out = measure(around(dim), geometry, RATE, model)
    assert rms((out["z"] - cube["z"][:1])[0, series.inside]) / PIXEL < 0.02


def test_nodes_outside_the_common_view_are_nan_and_marked(series):
    wide = Grid(x=(-0.5, 0.5), y=(-0.14, 0.14), step=0.02)
    out = measure(series.block(), GridGeometry(series.rig, wide), RATE)
    x, y = np.meshgrid(wide.x_nodes, wide.y_nodes)
    seen = np.all([camera.sees(x, y, 0.0) for camera in series.rig.cameras.values()], axis=0)
    outside = (out["quality"][0] & Quality.OUTSIDE) > 0
    for name in CUBE_FIELDS:
        if name != "quality":
            assert np.isnan(out[name][0][outside]).all(), name
    assert np.isfinite(out["z"][0][~outside]).all()
    # the surface moves the edge by a centimetre at most
    assert (outside != ~seen).mean() < 0.06


def test_the_swinging_of_beads_that_stand_above_the_water_is_taken_off(series, geometry, model, cube):
    height = 4e-4
    standing = GridGeometry(series.rig, series.grid, Settings(bead_height=height))
    out = measure(series.block(steps=3), standing, RATE, Model(standing, model.record))
    inside = np.s_[:, 4:-4, 4:-4]
    # of the surface at the water, not at the node
    slopes = (slope(cube["z"], series.grid.step, axis) for axis in (2, 1))
    rise = cube["z_t"] + sum(cube[name] * part for name, part in zip("uv", slopes))
    for name, axis in (("u", 2), ("v", 1)):
        tilt = np.gradient(rise, series.grid.step, axis=axis)
        more = out[name] - cube[name]
        np.testing.assert_allclose(more[inside], height * tilt[inside], atol=1e-7)
        assert rms(more[inside]) > 1e-4
        assert (out[f"{name}_std"][inside] >= cube[f"{name}_std"][inside]).all()
    for name in ("z", "w"):
        np.testing.assert_array_equal(out[name], cube[name])
    with pytest.raises(ExperimentError, match="do not float"):
        Settings(bead_height=height, sheet_thickness=1e-3)
