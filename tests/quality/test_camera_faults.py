"""A camera that contradicts the others is named with its fault; sound cameras are not."""

from dataclasses import replace

import numpy as np
import pytest
from cube_cases import HERE

from wavefield.grid import Grid
from wavefield.pipeline import check
from wavefield.pipeline.assess import compare_cameras
from wavefield.pipeline.prepare import prepare
from wavefield.quality.cameras import PatchMatcher, find_camera_faults
from wavefield.store.verdict import Remark, Verdict, read_verdict
from wavefield.tank import Scene, Tank, simulate

FRAMES = (1, 4)
COUNT = 8


class Shots:
    """Images of a simulated tank, rendered when first read."""

    def __init__(self, seed, **faults):
        self.tank = Tank(Scene.load("demo").with_(rig={"crop": 0.32}, faults=faults, seed=seed))
        self.drawn = {}

    def __call__(self, name, frame):
        if frame not in self.drawn:
            self.drawn[frame] = self.tank.render(frame)
        return self.drawn[frame][name]


GRID = Grid((-0.28, 0.28), (-0.2, 0.2), 0.01)


def found(read, rig=None, frames=FRAMES):
    matcher = PatchMatcher(read, rig or SOUND.tank.rig, GRID)
    return find_camera_faults(matcher, COUNT, frames)


SOUND = Shots(11)


def covered(name, frame):
    image = np.array(SOUND(name, frame))
    if name == "cam2":
        image[: image.shape[0] // 2] = 2
    return image


def swapped(name, frame):
    return SOUND({"cam1": "cam2", "cam2": "cam1"}.get(name, name), frame)


def mirrored(name, frame):
    image = SOUND(name, frame)
    return image[:, ::-1] if name == "cam1" else image


def late(name, frame):
    return SOUND(name, max(frame - 1, 0) if name == "cam3" else frame)


@pytest.mark.parametrize(
    ("read", "subject", "kind", "expected"),
    [
        (mirrored, "cam1", "mirrored", "its images are mirrored"),
        (swapped, "cam1", "swapped", "only as images of cam2"),
        (late, "cam3", "offset", "differ from those of the others by +1"),
        (covered, "cam2", "covered", "have no texture in"),
        (Shots(11, cam2={"defocus": 2.0}), "cam2", "blurred", "blurred by"),
    ],
)
def test_a_faulty_camera_is_named_with_its_fault(read, subject, kind, expected):
    remarks = found(read).remarks
    assert [(r.subject, r.kind) for r in remarks] == [(subject, kind)]
    assert expected in str(remarks[0])


def test_a_knocked_camera_is_named_and_the_miss_is_reported_in_px():
    rig = SOUND.tank.rig
    turned = replace(rig["cam1"], cy=rig["cam1"].cy + 2)
    (remark,) = found(SOUND, replace(rig, cameras={**rig.cameras, "cam1": turned})).remarks
    assert (remark.subject, remark.kind) == ("cam1", "moved")
    assert 0.3 < remark.values["eps_y cam1-cam3"] < 3
    assert remark.values["eps_y cam2-cam3"] < 0.1


def test_a_camera_knocked_along_the_parallax_makes_heights_disagree():
    rig = SOUND.tank.rig
    turned = replace(rig["cam1"], cx=rig["cam1"].cx + 1)
    (remark,) = found(SOUND, replace(rig, cameras={**rig.cameras, "cam1": turned})).remarks
    assert (remark.subject, remark.kind) == ("rig", "moved")
    assert abs(remark.values["height"]) == pytest.approx(1.0, abs=0.4)
    assert "see the same water at different heights" in str(remark)


def test_sound_cameras_raise_no_alarm():
    seen = found(SOUND)
    assert seen.remarks == ()
    assert min(min(pair["agreement"]) for pair in seen.pairs.values()) > 0.3


def test_a_verdict_is_one_line_a_status_and_a_file_beside_the_cube(tmp_path):
    grave = Remark("cam1", "mirrored", "grave", "it agrees so", "as calibrated", "correct it", {"share": 0.8})
    light = Remark("record", "gaps", "remark", "3 frames are missing")
    verdict = Verdict([light, grave])
    assert verdict.line == "not to be trusted: cam1 mirrored, record gaps"
    assert verdict.exit_status == 3
    assert Verdict([light]).line == "sound with remarks: record gaps"
    assert Verdict().line == "sound"
    assert Verdict().exit_status == 0
    verdict.save(tmp_path / "cube.zarr")
    assert read_verdict(tmp_path / "cube.zarr") == verdict
    assert read_verdict(tmp_path / "other.zarr") is None
    assert str(grave) == "cam1: it agrees so. as calibrated. correct it. [mirrored]"


@pytest.mark.slow
@pytest.mark.parametrize(
    "wave", [{"wavelength": 2.0, "amplitude": 0.08, "phase": 90.0}, {"wavelength": 12.0, "amplitude": 0.16}]
)
def test_waves_steeper_or_higher_than_patches_are_searched_for_are_no_disagreement(tmp_path, wave):
    sea = {"kind": "single", "direction": 30.0, "phase": 0.0} | wave
    scene = SOUND.tank.scene.with_(sea=sea, frames=12)
    assert check(simulate(scene, tmp_path), rig=scene.build_rig(), workflow=HERE).exit_status == 0


@pytest.mark.parametrize("thickness", [0.0005, 0.004], ids=["thin", "deep"])
def test_a_sound_light_sheet_is_not_called_untrustworthy_for_its_depth(thickness, tmp_path):
    surface = {"kind": "sheet", "thickness": thickness}
    scene = Scene.load("sheet").with_(frames=2, seed=11, surface=surface, calibration={"tilted": 0})
    experiment = simulate(scene, tmp_path, workers=1)
    assert compare_cameras(prepare(experiment, scene.build_rig()), np.zeros(0, np.uint16)).remarks == ()
