from dataclasses import replace

import cv2
import numpy as np
import pytest
from solve_cases import MESH, views

from wavefield.calibration import calibrate, check_rig, refine_and_level
from wavefield.calibration.camera_start import physical_frame
from wavefield.calibration.observations import Findings, Observations
from wavefield.calibration.still_water import sight_points
from wavefield.errors import CalibrationError
from wavefield.rig import Rig
from wavefield.tank.rigs import paper_rig


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    calibrate(views(), MESH, model="f tilt k1").rig.save(path)
    return Rig.load(path)  # from its file, as a user would


def bumped(name, axis, degrees=0.02):
    rig = paper_rig()
    turn = cv2.Rodrigues(np.radians(degrees) * np.asarray(axis) / np.linalg.norm(axis))[0]
    camera = rig[name]
    return Rig({**rig.cameras, name: replace(camera, rotation=turn @ camera.R, translation=turn @ camera.T)})


def wave(x, y):
    return 0.03 * np.cos(6 * x + 2 * y)


def rest(x, y):
    return 0 * x


def matches(rig, surface, noise=0.07, count=1000):
    rng = np.random.default_rng(7)
    x, y = rng.uniform(-1, 1, count), rng.uniform(-0.75, 0.75, count)
    out = {}
    for name in rig:
        seen = rig[name].sees(x, y, surface(x, y))
        pixel = np.stack(rig[name].project(x, y, surface(x, y)), -1) + noise * rng.normal(size=(count, 2))
        out[name] = np.where(seen[:, None], pixel, np.nan)
    return out, surface(x, y)


def test_a_sound_rig_is_left_alone(calibrated):
    found = check_rig(calibrated, matches(paper_rig(), wave)[0])
    assert found.moved is None
    assert found.faulty_cameras == ()
    assert found.misfit == pytest.approx(0.07, rel=0.05)
    assert "no camera has moved" in found.sentence
    new, _, _ = refine_and_level(calibrated, matches(paper_rig(), rest)[0])
    p = np.array([[0.3, -0.4, 0.02]]).T
    for name in calibrated:
        assert np.hypot(*(np.stack(new[name].project(*p)) - np.stack(calibrated[name].project(*p)))) < 0.02


def test_a_bumped_camera_is_named_on_any_record(calibrated):
    found = check_rig(calibrated, matches(bumped("cam1", (1, 0, 0)), wave)[0])
    assert found.moved == "cam1"
    assert 0.01 < found.angle < 0.03  # turning and shifting look nearly alike
    assert "cam1" in found.sentence


def test_frames_of_different_moments_are_not_taken_for_a_bumped_camera(calibrated):
    now, later = (
        matches(paper_rig(), lambda x, y, t=t: 0.03 * np.cos(40 * x - 20 * t))[0] for t in (0, 0.05)
    )
    found = check_rig(calibrated, now | {"cam2": later["cam2"]})
    assert found.misfit > 0.3
    assert found.moved is None
    assert "are the frames of the same moments" in found.sentence


@pytest.mark.parametrize(("name", "axis"), [("cam1", (1, 2, 1)), ("cam2", (0, 1, 0))])
def test_a_bumped_camera_is_corrected_from_still_water(calibrated, name, axis):
    """Turns about y hide from sight lines in a rig along x: the water's plane names the camera."""
    true = bumped(name, axis)
    new, verdict, plane = refine_and_level(calibrated, matches(true, rest)[0])
    assert verdict.moved == name
    assert plane.rms < 2e-4
    exact, z = matches(true, wave, noise=0.0)
    assert np.sqrt(np.nanmean((sight_points(calibrated, exact)[2] - z) ** 2)) > 1e-4
    assert np.sqrt(np.nanmean((sight_points(new, exact)[2] - z) ** 2)) < 2e-5
    assert new.provenance["refined"]["moved"]


def test_two_cameras_do_not_determine_which_moved(calibrated):
    pixels, _ = matches(bumped("cam1", (1, 0, 0)), wave)
    found = check_rig(calibrated, {name: pixels[name] for name in ("cam1", "cam2")})
    assert found.moved is None
    assert found.faulty_cameras == ("cam1", "cam2")
    assert "cam1 or cam2" in found.sentence


def test_a_rig_of_another_program_is_checked_without_a_covariance():
    true = bumped("cam1", (1, 0, 0), degrees=0.1)
    found = check_rig(paper_rig(), matches(true, wave)[0])
    assert found.moved == "cam1"
    assert check_rig(paper_rig(), matches(paper_rig(), wave)[0]).moved is None


def test_bad_matches_are_refused(calibrated):
    pixels, _ = matches(paper_rig(), wave)
    with pytest.raises(CalibrationError, match="two cameras"):
        check_rig(calibrated, {"cam1": pixels["cam1"]})
    with pytest.raises(CalibrationError, match="cam9"):
        check_rig(calibrated, {**pixels, "cam9": pixels["cam1"]})
    with pytest.raises(CalibrationError, match="50 at least"):
        check_rig(calibrated, {name: p[:20] for name, p in pixels.items()})


def test_a_turn_that_matches_do_not_determine_is_refused():
    """Two cameras of another program, a lens lost in conversion: no turn is the remedy, and none is made."""
    rig = paper_rig()
    true = Rig({"cam1": replace(rig["cam1"], p1=0.01), "cam2": replace(rig["cam2"], p1=-0.006)})
    imported = Rig({n: rig[n] for n in ("cam1", "cam2")})
    pixels, _ = matches(true, rest, count=300)
    found = check_rig(imported, pixels)
    assert found.misfit > 1
    assert "has not moved and is not corrected" in found.sentence
    assert found.moved is None
    _, verdict, _ = refine_and_level(imported, pixels)
    assert verdict.refused


def test_a_rig_of_other_images_is_reported():
    rig = paper_rig()
    swapped = Rig({"cam1": rig["cam2"], "cam2": rig["cam1"], "cam3": rig["cam3"]})
    found = check_rig(swapped, matches(paper_rig(), rest)[0])
    assert found.misfit > 5
    assert "does not fit these images" in found.sentence


def test_without_a_flat_view_the_note_names_the_view_on_which_z_is_zero():
    def numbers(*values):
        return np.array(values)

    seen = Observations(
        ("left", "right"),
        ("seen by one", "seen by both"),
        ((9, 9),) * 2,
        np.zeros((1, 2), int),
        np.zeros((1, 3)),
        1.0,
        numbers(0, 0, 1),
        numbers(0, 1, 1),
        numbers(0, 0, 0),
        np.zeros((3, 2)),
        np.ones(3),
    )
    findings = Findings()
    frame = physical_frame(seen, "", findings)
    assert seen.poses[frame.reference] == "seen by both"
    assert "in view seen by both;" in findings.notes[0]
