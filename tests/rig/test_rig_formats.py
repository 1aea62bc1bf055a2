import csv
import xml.etree.ElementTree as ET

import cv2
import numpy as np
import pytest
import scipy.io
import yaml
from rig_cases import TERMS, random_camera
from scipy.spatial.transform import Rotation

from wavefield.errors import RigError
from wavefield.rig import Camera, Rig
from wavefield.rig.formats import load_rig, save_opencv, save_uvmat
from wavefield.rig.stereo import epipolar_distance


def same(a, b, tolerance=1e-12):
    for key, value in a.to_dict().items():
        other = np.asarray(b.to_dict().get(key, 0.0), float)
        scale = max(1.0, np.abs(np.asarray(value, float)).max())
        assert np.abs(np.asarray(value, float) - other).max() <= tolerance * scale, key
    assert set(b.to_dict()) <= set(a.to_dict()) | set(TERMS)


def two(*without):
    return Rig({"cam1": random_camera(1, *without), "cam2": random_camera(2, *without)})


def test_own_file_keeps_every_bit(tmp_path):
    rig = Rig(two().cameras, {"date": "2026-01-01", "rms_px": {"cam1": 0.01}, "views": ["a", "b"]})
    rig.save(tmp_path / "new" / "rig.yaml")
    assert Rig.load(tmp_path / "new" / "rig.yaml") == rig
    assert not list(tmp_path.glob("**/*.partial"))


def test_own_file_states_its_units(tmp_path):
    two().save(tmp_path / "rig.yaml")
    data = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    assert data["units"] == {"length": "m", "image": "px", "angle": "rad"}
    data["units"]["length"] = "mm"
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(RigError, match="length is given in mm"):
        Rig.load(tmp_path / "rig.yaml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("fx"), "fx"),
        (lambda c: c.update(fov=3), "fov"),
        (lambda c: c.update(rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "right-handed"),
        (lambda c: c.update(rotation=[[1, 0, 0], [0, 2, 0], [0, 0, 1]]), "rotation"),
        (lambda c: c.update(fy=-3.0), "positive"),
        (lambda c: c.update(translation="far"), "cam1"),
    ],
)
def test_a_spoilt_camera_is_named(tmp_path, change, message):
    two().save(tmp_path / "rig.yaml")
    data = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    change(data["cameras"]["cam1"])
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(RigError, match=message) as error:
        Rig.load(tmp_path / "rig.yaml")
    assert "rig.yaml" in str(error.value)


def test_a_missing_rig_is_reported_with_its_command_and_an_unknown_camera_with_those_of_the_rig(tmp_path):
    with pytest.raises(RigError, match="wavefield calibrate"):
        Rig.load(tmp_path / "rig.yaml")
    with pytest.raises(RigError, match="cam1, cam2"):
        two()["cam9"]


def uvmat(shared):
    return shared / "data" / "piv_samples" / "Milestone" / "PCO_top.xml"


def test_uvmat_there_and_back(tmp_path, shared):
    size = (2560, 2160)
    first = load_rig(uvmat(shared), sizes={"PCO_top": size})["PCO_top"]
    save_uvmat(first, tmp_path / "PCO_top.xml")
    second = load_rig(tmp_path / "PCO_top.xml", sizes={"PCO_top": size})["PCO_top"]
    same(first, second)


def test_uvmat_points_project_to_their_marks(shared):
    calibration = ET.parse(uvmat(shared)).getroot().find("GeometryCalib")
    points = np.array([[float(v) for v in p.text.split()] for p in calibration.find("SourceCalib")])
    camera = load_rig(uvmat(shared), sizes={"PCO_top": (2560, 2160)})["PCO_top"]
    X, Y = camera.project(*(points[:, :3].T / 100))
    # UVMAT's origin is the outer corner of the lower left pixel, Y up
    miss = np.stack([X + 0.5 - points[:, 3], 2160 - 0.5 - Y - points[:, 4]], -1)
    stated = [float(v) for v in calibration.findtext("ErrorRms").split()]
    assert np.sqrt(np.mean(miss**2, axis=0)) == pytest.approx(stated, abs=1e-3)


def test_uvmat_needs_the_image_size(shared):
    with pytest.raises(RigError, match="image size"):
        load_rig(uvmat(shared))
    with pytest.raises(RigError, match="point marked at"):
        load_rig(uvmat(shared), sizes={"PCO_top": (1280, 1080)})


def test_one_uvmat_file_per_camera(tmp_path):
    rig = two("k2", "p1", "p2", "k3", "tau_x", "tau_y", "skew")
    for name in rig:
        save_uvmat(rig[name], tmp_path / f"{name}.xml")
    files = {name: tmp_path / f"{name}.xml" for name in rig}
    back = load_rig(files, sizes=dict.fromkeys(files, (1024, 1024)))
    for name in rig:
        same(rig[name], back[name])
    assert list(back) == ["cam1", "cam2"]


def test_uvmat_without_a_third_dimension_is_refused(tmp_path, shared):
    text = (
        uvmat(shared)
        .read_text()
        .replace('<R i="3">', "<Q>")
        .replace("0.998626\n      </R>", "0.998626\n      </Q>")
    )
    (tmp_path / "flat.xml").write_text(text)
    with pytest.raises(RigError, match="three dimensions"):
        load_rig(tmp_path / "flat.xml", sizes={"flat": (10, 10)})


def test_vic_calibration_fits_the_references_matches(shared):
    folder = shared / "data" / "d_specimen"
    rig = load_rig(folder / "cal.xml", names=["left", "right"])
    with open(folder / "reference" / "DICe_solution_0.txt") as file:
        rows = [r for r in csv.DictReader(file) if float(r["MATCH"]) == 0]
    X, Y, q, r = np.array(
        [
            [float(row[k]) for k in ("COORDINATE_X", "COORDINATE_Y", "CROSS_CORR_Q", "CROSS_CORR_R")]
            for row in rows
        ]
    ).T
    distance = epipolar_distance(rig["left"], rig["right"], X, Y, X + q, Y + r)
    assert np.median(abs(distance)) <= 0.13
    assert rig["left"].size == (1920, 1200)
    assert np.linalg.norm(rig["left"].centre - rig["right"].centre) == pytest.approx(0.1232, abs=1e-4)


@pytest.mark.parametrize("ending", ["yml", "xml"])
def test_opencv_there_and_back(tmp_path, ending):
    rig = two()
    save_opencv(rig, tmp_path / f"rig.{ending}")
    back = load_rig(tmp_path / f"rig.{ending}")
    for name in rig:
        same(rig[name], back[name], 1e-13)


def test_opencv_intrinsics_file(shared):
    rig = load_rig(shared / "data" / "stereo_chessboard" / "left_intrinsics.yml")
    camera = rig["cam1"]
    assert camera.fx == pytest.approx(535.91573396163199)
    assert camera.size == (640, 480)
    assert camera.p1 == pytest.approx(1.7831947042852964e-03)


def test_opencv_lens_models_that_are_not_ours_are_refused(tmp_path):
    storage = cv2.FileStorage(str(tmp_path / "rational.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("M1", np.eye(3))
    storage.write("D1", np.arange(8.0))
    storage.write("image_width", 10)
    storage.write("image_height", 10)
    storage.release()
    with pytest.raises(RigError, match="CALIB_RATIONAL_MODEL"):
        load_rig(tmp_path / "rational.yml")


def test_opencv_second_camera_without_a_pose_is_refused(shared):
    for sizes in ({}, {"cam1": (640, 480), "cam2": (640, 480)}):
        with pytest.raises(RigError, match="no pose"):
            load_rig(shared / "data" / "stereo_chessboard" / "intrinsics.yml", sizes=sizes)


K = np.array([[900.0, 0.0, 330.0], [0.0, 905.0, 250.0], [0.0, 0.0, 1.0]])
D = np.array([-0.1, 0.02, 1e-3, -2e-3, 0.01])
TURN = cv2.Rodrigues(np.array([0.02, -0.3, 0.05]))[0]
SHIFT = np.array([-0.4, 0.01, 0.05])


def stereo_pair(size=(640, 480)):
    return Rig(
        {
            "cam1": Camera.from_opencv(K, D, np.eye(3), np.zeros(3), size),
            "cam2": Camera.from_opencv(K, D, TURN, SHIFT, size),
        }
    )


def same_rig(found):
    for name, camera in stereo_pair().cameras.items():
        same(found[name], camera, 1e-9)


def test_bouguets_stereo_results(tmp_path):
    lens = {"fc": [900.0, 905.0], "cc": [330.0, 250.0], "kc": D, "alpha_c": 0.0}
    data = {f"{name}_{side}": v for side in ("left", "right") for name, v in lens.items()}
    scipy.io.savemat(
        tmp_path / "Calib_Results_stereo.mat", data | {"R": TURN, "T": 1e3 * SHIFT, "nx": 640, "ny": 480}
    )
    same_rig(load_rig(tmp_path / "Calib_Results_stereo.mat", unit="mm"))


def test_matlabs_own_structs_count_pixels_from_one(tmp_path):
    matrix = K.copy()
    matrix[:2, 2] += 1
    lens = {
        "IntrinsicMatrix": matrix.T,
        "RadialDistortion": D[[0, 1, 4]],
        "TangentialDistortion": D[2:4],
        "ImageSize": [480, 640],
    }
    params = {"CameraParameters1": lens, "CameraParameters2": lens}
    params |= {"RotationOfCamera2": TURN.T, "TranslationOfCamera2": 1e3 * SHIFT}
    scipy.io.savemat(tmp_path / "stereo.mat", {"params": params})
    same_rig(load_rig(tmp_path / "stereo.mat", unit="mm"))
    scipy.io.savemat(tmp_path / "nothing.mat", {"x": 3.0})
    with pytest.raises(RigError, match="holds no calibration"):
        load_rig(tmp_path / "nothing.mat")


@pytest.mark.parametrize(
    "names", [("cameraMatrix1", "distCoeffs1"), ("K_left", "D_left"), ("Intrinsics", "kc")]
)
def test_opencv_matrices_under_usual_names(tmp_path, names):
    storage = cv2.FileStorage(str(tmp_path / "cal.xml"), cv2.FILE_STORAGE_WRITE)
    storage.write(names[0], K)
    storage.write(names[1], D[None])
    storage.release()
    same(load_rig(tmp_path / "cal.xml", sizes={"cam1": (640, 480)})["cam1"], stereo_pair()["cam1"], 1e-9)


PIXEL = 0.00274  # mm


def davis_camera(number, camera):
    """A camera as DaVis writes it: lengths in millimetres, angles about x, y, z in turn."""
    rx, ry, rz = Rotation.from_matrix(camera.R).as_euler("xyz")
    tx, ty, tz = 1e3 * camera.T
    return (
        f'<CoordinateMapper CameraIdentifier="{number}" Type="PinholeOpenCV"><PinholeParameters>'
        f'<CommonParameters><OriginalImageSize Width="{camera.size[0]}" Height="{camera.size[1]}"/>'
        "</CommonParameters><InternalCameraParameters>"
        f'<FocalLengthPixel x="{camera.fx * PIXEL!r}" y="{camera.fy * PIXEL!r}"/>'
        f'<PrincipalPoint x="{camera.cx!r}" y="{camera.cy!r}"/><SensorPixelSizeMm Value="{PIXEL}"/>'
        f'<RadialDistortion radialDistortionCoefficient1="{camera.k1!r}" '
        f'radialDistortionCoefficient2="{camera.k2!r}"/>'
        f'<TangentialDistortion tangentialDistortionCoefficient1="{camera.p1!r}" '
        f'tangentialDistortionCoefficient2="{camera.p2!r}"/></InternalCameraParameters>'
        f'<ExternalCameraParameters><RotationAngles Rx="{rx}" Ry="{ry}" Rz="{rz}"/>'
        f'<TranslationMm Tx="{tx}" Ty="{ty}" Tz="{tz}"/></ExternalCameraParameters>'
        "</PinholeParameters></CoordinateMapper>"
    )


def write_davis(folder, rig):
    """A file of DaVis with the cameras of a rig."""
    mappers = [davis_camera(number, camera) for number, camera in enumerate(rig.cameras.values(), 1)]
    system = f"<CoordinateSystem>{''.join(mappers)}</CoordinateSystem>"
    (folder / "Calibration.xml").write_text(
        f"<Calibration><CoordinateSystemsForEachView>{system}</CoordinateSystemsForEachView></Calibration>"
    )
    return folder / "Calibration.xml"


def test_a_calibration_of_davis_is_read(tmp_path):
    rig = two("k3", "tau_x", "tau_y", "skew")
    read = load_rig(write_davis(tmp_path, rig))
    for name in rig:
        same(rig[name], read[name], 1e-9)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('Type="PinholeOpenCV"', 'Type="Polynomial3rdOrder"', "of the kind Polynomial3rdOrder"),
        (
            "<CoordinateSystem>",
            "<CoordinateSystem><CoordinateMapper/></CoordinateSystem><CoordinateSystem>",
            "2 coord",
        ),
        ("<SensorPixelSizeMm", "<Sensor", "<SensorPixelSizeMm Value=...> is missing"),
    ],
)
def test_a_calibration_of_davis_that_is_not_read_is_refused_with_the_remedy(tmp_path, old, new, expected):
    path = write_davis(tmp_path, two("k3", "tau_x", "tau_y", "skew"))
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(RigError, match=expected):
        load_rig(path)


def test_a_correction_field_of_davis_is_not_passed_over(tmp_path):
    path = write_davis(tmp_path, two("k3", "tau_x", "tau_y", "skew"))
    (tmp_path / "Correction field").mkdir()
    with pytest.raises(RigError, match="correction field of DaVis' self-calibration is next to it"):
        load_rig(path)
