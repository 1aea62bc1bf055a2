"""Cameras are solved from views of a target, their stated uncertainties hold, and what is wrong is named."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from solve_cases import MESH, nodes, poses, views

from wavefield.calibration import Target, calibrate
from wavefield.calibration.bundle import fit
from wavefield.calibration.camera_start import calibrate_single
from wavefield.calibration.observations import Geometry, collect
from wavefield.calibration.points import TargetPoints
from wavefield.calibration.still_water import sight_points
from wavefield.errors import CalibrationError
from wavefield.figures.style import panels
from wavefield.reports.calibration import rig_sentences, write_calibration
from wavefield.rig import Rig
from wavefield.rig.water_level import level
from wavefield.tank.rigs import paper_rig

FAST = "f tilt k1"  # the model of the simulated cameras


@pytest.fixture(scope="module")
def rig():
    return paper_rig()


@pytest.fixture(scope="module")
def good():
    return views()


def field(height=0.0):
    x, y = np.meshgrid(np.linspace(-0.95, 0.95, 15), np.linspace(-0.7, 0.7, 11))
    return x.ravel(), y.ravel(), np.broadcast_to(height, x.size)


def reprojection(found, rig):
    worst = 0.0
    for name in rig:
        for height in (-0.05, 0.0, 0.05):
            p = field(height)
            seen = rig[name].sees(*p)
            miss = np.stack(found[name].project(*p)) - np.stack(rig[name].project(*p))
            worst = max(worst, np.sqrt(np.mean(miss[:, seen] ** 2)))
    return worst


def z_error(found, rig, z):
    x, y, _ = field()
    seen = {name: np.stack(rig[name].project(x, y, z(x, y)), -1) for name in rig}
    return np.sqrt(np.mean((sight_points(found, seen)[2] - z(x, y)) ** 2))


def wavy(x, y):
    return 0.03 * np.cos(6 * x + 2 * y)


def swapped(views, camera, pose, points):
    return {**views, camera: {**views[camera], pose: points}}


def test_node_zero_may_be_away_from_the_origin(good):
    here = calibrate(good, MESH, model=FAST).rig
    there = calibrate(good, Target("strings", mesh=MESH, origin=(0.25, -0.1)), model=FAST).rig
    for name in here:
        assert there[name].centre == pytest.approx(here[name].centre + np.array([0.25, -0.1, 0.0]), abs=1e-6)


def test_simulated_rig_is_found(good, rig):
    found = calibrate(good, MESH)
    assert found.usable
    assert found.problems == ()
    assert found.model == FAST  # the simplest that the data support: the one the images were made with
    assert reprojection(found.rig, rig) < 0.003
    assert z_error(found.rig, rig, lambda x, y: 0 * x) < 5e-6
    assert z_error(found.rig, rig, wavy) < 5e-6
    assert found.predicted.z_std < 5e-6
    assert found.fit.scale == pytest.approx(1.0, abs=0.03)


def test_rig_file_holds_its_provenance(good, tmp_path):
    calibrate(good, MESH, model=FAST).rig.save(tmp_path / "rig.yaml")
    stated = Rig.load(tmp_path / "rig.yaml").provenance
    assert stated["model"] == FAST
    assert stated["usable"] is True
    assert stated["cameras"]["cam1"]["rms_px"] == pytest.approx(0.005, rel=0.1)
    assert stated["cameras"]["cam1"]["parameter_std"]["f"] > 0
    assert len(stated["covariance"]["parameters"]) == len(stated["covariance"]["lower"])


def test_an_imperfect_target_is_solved_for_and_levelled(rig):
    offset = 1e-3 * np.random.default_rng(5).normal(size=(len(nodes()), 3))
    seen = views(offsets=offset)
    found = calibrate(seen, MESH, model=FAST, target_std=1e-3)
    assert found.usable
    place = {tuple(n): k for k, n in enumerate(nodes())}
    true = offset[[place[tuple(n)] for n in found.observations.nodes]]
    assert np.sqrt(np.mean((found.fit.geometry.offset - true) ** 2)) < 2e-4
    x, y, z = field()
    rest = {name: np.stack(rig[name].project(x, y, z), -1) for name in rig}
    flat, _ = level(found.rig, *sight_points(found.rig, rest)[:3])
    assert z_error(flat, rig, wavy) < 3e-5
    # taken as perfect, the same target spoils the shape of the surface
    naive = calibrate(seen, MESH, model=FAST)
    naive, _ = level(naive.rig, *sight_points(naive.rig, rest)[:3])
    assert z_error(naive, rig, wavy) > 3 * z_error(flat, rig, wavy)


def test_a_camera_without_a_flat_view_is_tied_by_the_tilted_ones(good, rig):
    part = {**good, "cam2": {p: v for p, v in good["cam2"].items() if p != "flat"}}
    found = calibrate(part, MESH, model=FAST)
    assert found.usable
    assert reprojection(found.rig, rig) < 0.005


def test_without_a_flat_view_the_frame_is_named(good):
    part = {name: {p: v for p, v in of.items() if p != "flat"} for name, of in good.items()}
    found = calibrate(part, MESH, flat="", model=FAST)
    assert found.usable
    assert any("level the rig on the water" in note for note in found.notes)
    assert not calibrate(part, MESH, model=FAST).usable


def the_problem(found):
    assert not found.usable
    assert len(found.problems) == 1, found.problems
    return found.problems[0]


def test_too_few_views(good):
    part = {name: {p: v for p, v in of.items() if p in ("tilt_0", "flat")} for name, of in good.items()}
    found = calibrate(part, MESH, model=FAST)
    assert not found.usable
    assert any("cam1 has 2 usable views" in p for p in found.problems)


def test_views_without_a_target_are_noted_and_cameras_without_any_named(good):
    nothing = TargetPoints(np.zeros((0, 2), int), np.zeros((0, 2)), np.zeros(0), (1024, 1024))
    found = calibrate({**good, "cam2": dict.fromkeys(good["cam2"], nothing)}, MESH, model=FAST)
    assert "no target was found in any view of cam2" in the_problem(found)
    assert "cam1" in found.rig.cameras
    found = calibrate(swapped(good, "cam2", "tilt_1", nothing), MESH, model=FAST)
    assert found.usable
    assert any("cam2 tilt_1: no target found" in note for note in found.notes)


def test_a_camera_that_saw_other_poses_than_the_rest(good):
    found = calibrate({**good, "cam3": {f"other_{p}": v for p, v in good["cam3"].items()}}, MESH, model=FAST)
    assert "cam3 shares no view" in the_problem(found)


def test_mixed_sizes_are_named(good):
    v = good["cam1"]["tilt_2"]
    found = calibrate(swapped(good, "cam1", "tilt_2", replace(v, size=(512, 512))), MESH, model=FAST)
    assert "tilt_2 (512 x 512)" in the_problem(found)


def mirror(points):
    """As found in an image flipped left to right: the finder takes the other side for +y."""
    pixel = np.column_stack([points.size[0] - 1 - points.pixel[:, 0], points.pixel[:, 1]])
    return replace(points, pixel=pixel, node=points.node * (1, -1))


def test_a_mirrored_camera_is_named(good):
    spoilt = {**good, "cam2": {p: mirror(v) for p, v in good["cam2"].items()}}
    assert "images of cam2 are mirrored" in the_problem(calibrate(spoilt, MESH, model=FAST))
    del spoilt["cam3"]
    assert "mirrored" in the_problem(calibrate(spoilt, MESH, model=FAST))


def test_a_wrong_mesh_shows_against_a_stated_distance(good):
    assert calibrate(good, MESH, model=FAST, camera_distance={"cam3": 4.35}).usable
    found = calibrate(good, 0.05, model=FAST, camera_distance={"cam3": 4.35})
    assert "may be 100 mm" in the_problem(found)
    assert "2.18 m" in the_problem(found)


def test_parallel_views_are_degenerate():
    where = poses(tilts=[(0, 0)] * 5)
    found = calibrate(views(where=where), MESH, model=FAST)
    assert not found.usable
    assert any("parallel" in p and "tilted by 20 to 40" in p for p in found.problems)


def test_a_view_indexed_a_quarter_turn_off_is_left_out(good, rig):
    v = good["cam2"]["tilt_3"]
    turned = replace(v, node=np.stack([-v.node[:, 1], v.node[:, 0]], axis=-1))
    found = calibrate(swapped(good, "cam2", "tilt_3", turned), MESH, model=FAST)
    assert found.usable
    assert any(note.startswith("cam2 tilt_3") for note in found.notes)
    assert found.left_out["cam2 tilt_3"] == len(v)
    assert reprojection(found.rig, rig) < 0.005


def test_a_view_of_something_else_is_left_out(good):
    v = good["cam2"]["tilt_1"]
    noise = replace(v, pixel=np.random.default_rng(0).uniform(0, 1000, v.pixel.shape))
    found = calibrate(swapped(good, "cam2", "tilt_1", noise), MESH, model=FAST)
    assert found.usable
    assert any("cam2 tilt_1: its points are not a plane grid" in note for note in found.notes)


def test_views_in_another_order_are_reported(good):
    other = dict(zip(good["cam2"], list(good["cam2"].values())[::-1]))
    found = calibrate({**good, "cam2": other}, MESH, model=FAST)
    assert "the target moved differently in the views of cam2 and of cam1 and cam3" in the_problem(found)


def test_false_points_are_left_out(good, rig):
    rng = np.random.default_rng(1)
    spoilt = {}
    for name, of in good.items():
        spoilt[name] = {}
        for p, v in of.items():
            bad = rng.random(len(v)) < 0.03
            spoilt[name][p] = replace(v, pixel=v.pixel + bad[:, None] * rng.uniform(-30, 30, v.pixel.shape))
    found = calibrate(spoilt, MESH, model=FAST)
    assert found.usable
    assert sum(found.left_out.values()) > 100
    assert reprojection(found.rig, rig) < 0.003


def test_an_unknown_model_is_refused(good):
    for model in ("fisheye", "f banana", "c k1"):
        with pytest.raises(CalibrationError, match=f"camera model '{model}' is not made of f, aspect, c"):
            calibrate(good, MESH, model=model)


def test_report_holds_pictures_and_numbers(good, tmp_path):
    found = calibrate(good, MESH, model=FAST)
    page = write_calibration(found, tmp_path / "report", panels(1)[0])
    text = page.read_text()
    assert text.index("as it was found in an image") < text.index("The rig, and the water")
    assert "Verdict: the rig can be used" in text
    for name in ("cam1", "cam2", "cam3"):
        assert f"Residuals of {name}" in text
    assert text.count("data:image/png;base64,") == 7
    for sentence in rig_sentences(found.rig):  # what the command prints
        assert sentence.split(";")[0].replace("'", "&#39;") in text
    stated = yaml.safe_load((tmp_path / "report" / "numbers.yaml").read_text())
    assert stated["cameras"]["cam1"]["rms_px"] == pytest.approx(0.005, rel=0.1)
    assert stated["flat_target"]["z_rms_mm"] < 0.02
    assert stated["epipolar"]["cam1 - cam2"]["rms_px"] == pytest.approx(0.007, rel=0.2)
    fx, std = stated["parameters"]["cam1"]["fx_px"]
    assert abs(fx - paper_rig()["cam1"].fx) < 5 * std


def test_report_of_a_failure_contains_the_remedy(tmp_path):
    found = calibrate({}, MESH)
    assert not found.usable
    page = write_calibration(found, tmp_path)
    assert "no views of the target" in page.read_text()
    assert yaml.safe_load((tmp_path / "numbers.yaml").read_text())["usable"] is False


@pytest.mark.slow
def test_stated_uncertainties_are_those_that_occur():
    rig = paper_rig()
    name = "cam1"
    z = []
    for seed in range(6):
        o = collect({name: views({name: rig[name]}, seed=seed, noise=0.05)[name]}, MESH)
        truth = rig[name]
        g = calibrate_single(o)
        start = Geometry(
            g.lens[None],
            *(np.stack([g.poses["flat"][k]]) for k in range(2)),
            np.stack([g.poses["flat"][0].T @ g.poses[p][0] for p in o.poses]),
            np.stack([g.poses["flat"][0].T @ (g.poses[p][1] - g.poses["flat"][1]) for p in o.poses]),
            np.zeros((len(o.nodes), 3)),
        )
        start.lens[:, 2:4] = 511.5
        found = fit(o, start, [("f", "k1", "tilt")], o.poses.index("flat"))
        std = np.sqrt(np.diag(found.covariance))
        lens = found.geometry.lens[0]
        z += [np.log(lens[0] / truth.fx) / std[0], (lens[4] - truth.k1) / std[1]]
        z += [(lens[9] - truth.tau_x) / std[2], (lens[10] - truth.tau_y) / std[3]]
        assert found.scale == pytest.approx(1.0, abs=0.05)
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.5
