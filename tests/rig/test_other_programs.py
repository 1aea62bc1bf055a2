"""Rigs of DICe, OpenCV and MATLAB: there and back, and against the programs' own equations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from rig_cases import dice_xml, field, random_camera, vic_xml

from wavefield.errors import RigError
from wavefield.rig import Rig
from wavefield.rig.formats import load_rig, save_rig


def test_the_rig_file_of_the_documentation_is_read(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "rig-file.md").read_text()
    text = page.split("```yaml\n")[1].split("```")[0]
    (tmp_path / "rig.yaml").write_text(text)
    rig = load_rig(tmp_path / "rig.yaml")
    assert list(rig) == ["cam1", "cam2"]
    assert rig["cam1"].centre == pytest.approx([0.0, 0.0, 4.0])
    assert rig["cam2"].project(0.0, 0.0, 0.0) == pytest.approx((511.5, 511.5))


def misfit(one, other, seed=0):
    """Largest difference of the pixels of points, px."""
    X, Y, Z = field(seed)
    points = (0.2 * X, 0.2 * Y, 1.0 + Z) if one.T[2] < 1.0 else (X, Y, Z)  # a camera at the origin
    return max(np.abs(a - b).max() for a, b in zip(one.project(*points), other.project(*points), strict=True))


def test_two_cameras_of_matlab_there_and_back_in_the_frame_of_the_first(tmp_path):
    cameras = {f"cam{n}": random_camera(n, "tau_x", "tau_y") for n in (1, 2)}
    save_rig(Rig(cameras), tmp_path / "stereo.mat", "matlab")
    back = load_rig(tmp_path / "stereo.mat")
    one, two = cameras.values()
    turn = two.R @ one.R.T
    for camera, found, R, T in zip(
        (one, two), back.cameras.values(), (np.eye(3), turn), (np.zeros(3), two.T - turn @ one.T), strict=True
    ):
        assert found.size == camera.size
        for before, after in ((camera.K, found.K), (camera.D, found.D), (R, found.R), (T, found.T)):
            np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-12)


def test_matlabs_file_of_two_cameras_is_refused_for_others(tmp_path):
    three = {f"cam{n}": random_camera(n, "tau_x", "tau_y", "skew") for n in (1, 2, 3)}
    with pytest.raises(RigError, match="has two cameras, and this rig 3"):
        save_rig(Rig(three), tmp_path / "rig.mat", "matlab")
    with pytest.raises(RigError, match="does not have tau_x"):
        save_rig(Rig({f"cam{n}": random_camera(n) for n in (1, 2)}), tmp_path / "rig.mat", "matlab")


def test_a_fisheye_lens_of_opencv_is_refused(tmp_path):
    save_rig(Rig({"cam1": random_camera(1, "skew")}), tmp_path / "rig.yml", "opencv")
    with (tmp_path / "rig.yml").open("a") as stream:
        stream.write("fisheye_model: 1\n")
    with pytest.raises(RigError, match="fisheye"):
        load_rig(tmp_path / "rig.yml")


@pytest.mark.parametrize("form", [dice_xml, vic_xml])
def test_rigs_of_programs_of_image_correlation_are_read(tmp_path, form):
    rig = Rig({f"cam{n}": random_camera(n, "p1", "p2", "tau_x", "tau_y") for n in (1, 2, 3)})
    (tmp_path / "rig.xml").write_text(form(rig))
    for unit, metres in ((None, 1e-3), ("inch", 0.0254), ("0.5", 0.5)):
        back = load_rig(tmp_path / "rig.xml", unit=unit)
        for name, camera in rig.cameras.items():
            assert misfit(camera, replace(back[name], translation=back[name].T * 1e-3 / metres)) < 1e-8
            assert back[name].size == camera.size
            assert np.allclose(back[name].centre, camera.centre * metres / 1e-3, rtol=1e-9)


def test_dices_poses_relative_to_the_first_camera_are_read(tmp_path):
    one, two = (random_camera(n, "p1", "p2", "tau_x", "tau_y") for n in (1, 2))
    R = two.R @ one.R.T
    relative = replace(two, rotation=R, translation=two.T - R @ one.T)
    flag = '<Parameter name="extrinsics_relative_camera_to_camera" value="true"/>'
    text = dice_xml(Rig({"cam1": one, "cam2": relative})).replace(
        "<ParameterList>", f"<ParameterList>{flag}", 1
    )
    (tmp_path / "rig.xml").write_text(text)
    assert misfit(load_rig(tmp_path / "rig.xml")["cam2"], two) < 1e-8


def test_a_lens_model_of_dice_with_odd_radial_terms_is_refused(tmp_path):
    text = dice_xml(Rig({"cam1": random_camera(1, "p1", "p2", "tau_x", "tau_y")}))
    (tmp_path / "odd.xml").write_text(text.replace("OPENCV_LENS_DISTORTION", "K1R1_K2R2_K3R3"))
    with pytest.raises(RigError, match="calibrate with OPENCV_LENS_DISTORTION"):
        load_rig(tmp_path / "odd.xml")


@pytest.mark.parametrize("cut", [0.2, 0.7])
@pytest.mark.parametrize("program", ["dice", "vic3d", "opencv"])
def test_a_file_that_is_cut_ends_in_one_sentence(tmp_path, program, cut):
    path, rig = tmp_path / "rig.xml", Rig({"cam1": random_camera(1, "p1", "p2", "tau_x", "tau_y")})
    if program == "opencv":
        save_rig(rig, path, program)
    else:
        path.write_text({"dice": dice_xml, "vic3d": vic_xml}[program](rig))
    text = path.read_text()
    path.write_text(text[: int(cut * len(text))])
    with pytest.raises(RigError) as error:
        load_rig(path)
    assert "\n" not in str(error.value)


LENS = {
    "IntrinsicMatrix": [[2500.0, 0, 0], [0, 2500.0, 0], [641.0, 513.0, 1]],
    "RadialDistortion": [-0.1, 0.01],
    "ImageSize": [1024.0, 1280.0],
}


@pytest.mark.parametrize(
    ("words", "metres"),
    [("millimeters", 1e-3), ("mm", 1e-3), ("centimeters", 0.01), ("inches", 0.0254), ("m", 1.0)],
)
def test_the_unit_that_matlabs_struct_states_is_taken(tmp_path, words, metres):
    pair = {"CameraParameters1": LENS | {"WorldUnits": words}, "CameraParameters2": LENS}
    pair |= {"RotationOfCamera2": np.eye(3), "TranslationOfCamera2": [-100.0, 0, 0]}
    scipy.io.savemat(tmp_path / "stereo.mat", {"stereoParams": pair})
    rig = load_rig(tmp_path / "stereo.mat")
    assert rig["cam2"].centre[0] == pytest.approx(100 * metres)
    assert load_rig(tmp_path / "stereo.mat", unit="cm")["cam2"].centre[0] == pytest.approx(1.0)


def test_a_rig_without_a_unit_whose_cameras_would_be_far_apart_is_refused(tmp_path):
    pair = {"CameraParameters1": LENS, "CameraParameters2": LENS}
    pair |= {"RotationOfCamera2": np.eye(3), "TranslationOfCamera2": [-100.0, 0, 0]}
    scipy.io.savemat(tmp_path / "stereo.mat", {"stereoParams": pair})
    with pytest.raises(RigError, match="states no unit of length, and in metres its cameras are 100 m apart"):
        load_rig(tmp_path / "stereo.mat")
    assert load_rig(tmp_path / "stereo.mat", unit="mm")["cam2"].centre[0] == pytest.approx(0.1)
    assert load_rig(tmp_path / "stereo.mat", unit="m")["cam2"].centre[0] == pytest.approx(100.0)


def test_opencvs_two_files_are_read_as_one(tmp_path):
    rig = Rig({f"cam{n}": random_camera(n, "tau_x", "tau_y", "skew") for n in (1, 2)})
    save_rig(rig, tmp_path / "all.yml", "opencv")
    text = (tmp_path / "all.yml").read_text().replace("world_", "other_")
    at = text.index("R: !!opencv-matrix")
    (tmp_path / "extrinsics.yml").write_text("%YAML:1.0\n---\n" + text[at:])
    (tmp_path / "intrinsics.yml").write_text(text[:at])
    one, two = rig.cameras.values()
    found = load_rig(tmp_path / "intrinsics.yml")
    assert np.linalg.norm(found["cam2"].centre) == pytest.approx(np.linalg.norm(one.centre - two.centre))
    (tmp_path / "extrinsics.yml").unlink()
    with pytest.raises(RigError, match=r"put it next to intrinsics\.yml"):
        load_rig(tmp_path / "intrinsics.yml")
