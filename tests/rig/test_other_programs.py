"""Rigs of DICe, OpenPTV, MyPTV, Metashape and COLMAP: there and back, and against their own equations."""

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from rig_cases import field, random_camera, random_fisheye

from wavefield.commands.archive import rig as command
from wavefield.errors import RigError
from wavefield.rig import Rig
from wavefield.rig.formats import FOLDERS, load_rig, save_rig
from wavefield.rig.rotation import rotation_about

LACKING = {
    "dice": (),
    "colmap": ("tau_x", "tau_y", "skew"),
    "metashape": ("tau_x", "tau_y"),
    "myptv": ("k1", "k2", "k3", "p1", "p2", "tau_x", "tau_y", "skew"),
    "openptv": ("k1", "k2", "k3", "p1", "p2", "tau_x", "tau_y", "skew"),
}


def square(camera):
    """The camera with one focal length."""
    from dataclasses import replace

    return replace(camera, fy=camera.fx)


def misfit(one, other, seed=0):
    """Largest difference of the pixels of points, px."""
    X, Y, Z = field(seed)
    points = (0.2 * X, 0.2 * Y, 1.0 + Z) if one.T[2] < 1.0 else (X, Y, Z)  # a camera at the origin
    return max(np.abs(a - b).max() for a, b in zip(one.project(*points), other.project(*points), strict=True))


@pytest.mark.parametrize("program", LACKING)
def test_a_rig_there_and_back(tmp_path, program):
    cameras = {f"cam{n}": random_camera(n, *LACKING[program]) for n in (1, 2, 3)}
    if program in ("myptv", "openptv"):
        cameras = {name: square(camera) for name, camera in cameras.items()}
    path = tmp_path / "rig.xml"
    if program in FOLDERS:
        path = tmp_path
    save_rig(Rig(cameras), path, program)
    given = {name: tmp_path / name for name in cameras} if program == "myptv" else path
    back = load_rig(given)
    assert list(back) == list(cameras)
    for n, (name, camera) in enumerate(cameras.items()):
        assert misfit(camera, back[name], n) < 1e-8
        assert np.abs(camera.centre - back[name].centre).max() < 1e-9
        assert back[name].size == camera.size


@pytest.mark.parametrize("program", [p for p in LACKING if LACKING[p]])
def test_terms_that_a_program_lacks_are_refused(tmp_path, program):
    with pytest.raises(RigError, match="does not have"):
        save_rig(Rig({"cam1": random_camera(1)}), tmp_path, program)


@pytest.mark.parametrize("program", ["wass", "matlab"])
def test_two_cameras_there_and_back_in_the_frame_of_the_first(tmp_path, program):
    lacking = ("tau_x", "tau_y") if program == "matlab" else ("tau_x", "tau_y", "skew")
    cameras = {f"cam{n}": random_camera(n, *lacking) for n in (1, 2)}
    path = tmp_path if program in FOLDERS else tmp_path / "stereo.mat"
    save_rig(Rig(cameras), path, program)
    sizes = {name: camera.size for name, camera in cameras.items()} if program == "wass" else None
    back = load_rig(path, sizes)
    one, two = cameras.values()
    turn = two.R @ one.R.T
    for camera, found, R, T in zip(
        (one, two), back.cameras.values(), (np.eye(3), turn), (np.zeros(3), two.T - turn @ one.T), strict=True
    ):
        assert found.size == camera.size
        for before, after in ((camera.K, found.K), (camera.D, found.D), (R, found.R), (T, found.T)):
            np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("program", ["wass", "matlab"])
def test_programs_of_two_cameras_refuse_others(tmp_path, program):
    three = {f"cam{n}": random_camera(n, "tau_x", "tau_y", "skew") for n in (1, 2, 3)}
    with pytest.raises(RigError, match="has two cameras, and this rig 3"):
        save_rig(Rig(three), tmp_path / "rig", program)
    with pytest.raises(RigError, match="does not have tau_x"):
        save_rig(Rig({f"cam{n}": random_camera(n) for n in (1, 2)}), tmp_path, program)


def relative_to_first(cameras):
    """The cameras in the frame of the first."""
    from dataclasses import replace

    first = next(iter(cameras.values()))
    turned = ((name, camera, camera.R @ first.R.T) for name, camera in cameras.items())
    return {
        name: replace(camera, rotation=R, translation=camera.T - R @ first.T) for name, camera, R in turned
    }


@pytest.mark.parametrize("kind", ["radtan", "equidistant", "both"])
def test_kalibrs_chain_there_and_back_in_the_frame_of_the_first(tmp_path, kind):
    plain = {n: random_camera(n, "k3", "tau_x", "tau_y", "skew") for n in (1, 2, 3)}
    wide = {n: random_fisheye(n, "skew") for n in (1, 2, 3)}
    chosen = {"radtan": plain, "equidistant": wide, "both": {**plain, 2: wide[2]}}[kind]
    cameras = {f"cam{n}": camera for n, camera in chosen.items()}
    save_rig(Rig(cameras), tmp_path / "camchain.yaml", "kalibr")
    back = load_rig(tmp_path / "camchain.yaml")
    for name, camera in relative_to_first(cameras).items():
        found = back[name]
        assert (found.size, found.fisheye) == (camera.size, camera.fisheye)
        for before, after in (
            (camera.K, found.K),
            (camera.D, found.D),
            (camera.R, found.R),
            (camera.T, found.T),
        ):
            np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("program", ["opencv", "colmap", "metashape"])
def test_fisheye_lenses_there_and_back(tmp_path, program):
    cameras = {f"cam{n}": random_fisheye(n, *(["skew"] if program == "colmap" else [])) for n in (1, 2)}
    cameras["cam3"] = random_camera(3, "tau_x", "tau_y", "skew")
    path = (
        tmp_path if program in FOLDERS else tmp_path / ("rig.xml" if program == "metashape" else "rig.yaml")
    )
    save_rig(Rig(cameras), path, program)
    back = load_rig(path)
    for n, (name, camera) in enumerate(cameras.items()):
        assert back[name].fisheye == camera.fisheye
        assert misfit(camera, back[name], n) < 1e-8


def test_opencvs_own_sample_states_its_fisheye_model(tmp_path):
    camera = random_fisheye(4, "skew")
    storage = cv2.FileStorage(str(tmp_path / "out.yml"), cv2.FILE_STORAGE_WRITE)
    for key, value in (("image_width", 1024), ("image_height", 1024), ("fisheye_model", 1)):
        storage.write(key, value)
    storage.write("camera_matrix", camera.K)
    storage.write("distortion_coefficients", camera.D[:, None])
    storage.release()
    found = load_rig(tmp_path / "out.yml")["cam1"]
    assert found.fisheye
    assert np.array_equal(found.D, camera.D)


@pytest.mark.parametrize("program", ["dice", "wass", "matlab", "openptv", "myptv", "uvmat", "vic3d"])
def test_programs_without_fisheye_lenses_refuse_them(tmp_path, program):
    rig = Rig({f"cam{n}": square(random_fisheye(n, "skew")) for n in (1, 2)})
    with pytest.raises(RigError, match="fisheye"):
        save_rig(rig, tmp_path if program in FOLDERS else tmp_path / "rig.xml", program)


def openptv_folder(folder, size=(1024, 800), pixel=0.0065, media="1\n1\n1"):
    (folder / "parameters").mkdir()
    (folder / "cal").mkdir()
    (folder / "parameters" / "ptv.par").write_text(
        f"1\nimg/cam1.1\ncal/cam1.tif\n0\n0\n1\n{size[0]}\n{size[1]}\n{pixel}\n{pixel}\n0\n{media}\n0\n"
    )
    return folder


@pytest.mark.parametrize("seed", range(4))
def test_openptvs_own_equations(tmp_path, seed):
    """The optical axis is shifted first; distortion is about the middle of the image."""
    rng = np.random.default_rng(seed)
    size, pixel = (1024, 800), 0.0065
    folder = openptv_folder(tmp_path, size, pixel)
    centre, angles = np.array([*rng.uniform(-80, 80, 2), 2000.0]), rng.uniform(-0.06, 0.06, 3)
    xh, yh, cc = *rng.uniform(-0.1, 0.1, 2), rng.uniform(12, 20)
    k1, k2, p1, p2 = rng.uniform(-1, 1, 4) * (1e-3, 1e-5, 1e-4, 1e-4)
    scale, shear = 1 + rng.uniform(-1, 1) * 1e-3, rng.uniform(-1, 1) * 1e-3
    turn = (
        rotation_about([angles[0], 0, 0])
        @ rotation_about([0, angles[1], 0])
        @ rotation_about([0, 0, angles[2]])
    )
    rows = [centre, angles, *turn, [xh, yh, cc], [0, 0, 1]]
    (folder / "cal" / "cam1.tif.ori").write_text("\n".join(" ".join(repr(float(v)) for v in r) for r in rows))
    terms = [k1, k2, 0.0, p1, p2, scale, shear]
    (folder / "cal" / "cam1.tif.addpar").write_text(" ".join(repr(float(v)) for v in terms))
    camera = load_rig(folder)["cam1"]
    points = np.stack([*rng.uniform(-150, 150, (2, 300)), rng.uniform(-50, 50, 300)])
    d = turn.T @ (points - centre[:, None])
    x, y = -cc * d[0] / d[2] + xh, -cc * d[1] / d[2] + yh
    r2 = x * x + y * y
    factor = 1 + k1 * r2 + k2 * r2**2
    x, y = (
        x * factor + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y,
        y * factor + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y,
    )
    x, y = scale * (x - np.sin(shear) * y), scale * np.cos(shear) * y
    X, Y = x / pixel + size[0] / 2 - 0.5, size[1] / 2 - y / pixel - 0.5
    inside = (X > 0) & (Y > 0) & (X < size[0] - 1) & (Y < size[1] - 1)
    assert inside.sum() > 100
    found = camera.project(*(1e-3 * points))
    assert np.hypot(found[0] - X, found[1] - Y)[inside].max() < 0.05


def test_openptv_through_a_window_is_refused(tmp_path):
    folder = openptv_folder(tmp_path, media="1\n1.33\n1.46")
    with pytest.raises(RigError, match="refracting"):
        load_rig(folder)


def myptv_file(path, bent):
    rows = ["1280 1024 ", "48.5 80.2 528.5 ", "0.109 3.17 3.147 ", "6000.0", "-41.0 148.1 "]
    rows += ["".join(f"{v!r} " for v in row) for row in bent]
    path.write_text("Tsai model camera\ncam1\n" + "\n".join(rows) + "\n")
    return path


def test_myptvs_polynomial_is_fitted(tmp_path):
    bent = np.array(
        [[3e-3, -2e-3, -3.8e-6, -8e-7, 2.4e-6], [2.6e-4, -3e-6, -4e-8, 2.4e-6, -2.4e-6], [0.0] * 5]
    )
    rig = load_rig(myptv_file(tmp_path / "cam1", bent.tolist()), unit="mm")
    assert rig.provenance["imported"]["lens"].startswith("fitted to 0.0")
    camera = rig["cam1"]
    eta, zeta = np.random.default_rng(1).uniform(0, 1000, (2, 200))
    powers = np.stack([eta, zeta, eta**2, zeta**2, eta * zeta])
    e = bent @ powers
    sight = np.stack([eta - 640 + 41.0 + e[0], zeta - 512 - 148.1 + e[1], 6000.0 + e[2]])
    turn = rotation_about([0.109, 0, 0]) @ rotation_about([0, 3.17, 0]) @ rotation_about([0, 0, 3.147])
    points = np.array([48.5, 80.2, 528.5])[:, None] + turn.T @ sight * 0.08
    X, Y = camera.project(*(1e-3 * points))
    assert np.hypot(X - eta, Y - zeta).max() < 0.2


def test_a_polynomial_that_no_lens_fits_is_refused_with_the_remedy(tmp_path):
    bent = np.zeros((3, 5))
    bent[0, 3] = bent[1, 2] = 1e-3
    with pytest.raises(RigError, match=r"misses it by .* calibrate again"):
        load_rig(myptv_file(tmp_path / "cam1", bent.tolist()))


def dice_text(outer, k=(0.0, 0.0, 0.0)):
    lens = [600.0, 400.0, 2400.0, 2410.0, -0.2, *k]
    return "\n".join(f"{v!r} # a number" for v in [*lens, *lens, *outer, 800.0, 1200.0])


def test_dices_text_in_both_forms_is_one_rig(tmp_path):
    T = [130.75, -0.61, 17.1]
    (tmp_path / "angles.txt").write_text(dice_text([10.0, -18.0, 3.0, *T]))
    alpha, beta, gamma = np.radians([10.0, -18.0, 3.0])
    R = rotation_about([0, 0, gamma]) @ rotation_about([0, beta, 0]) @ rotation_about([alpha, 0, 0])
    (tmp_path / "matrix.txt").write_text(dice_text([*R.ravel().tolist(), *T]))
    one, other = load_rig(tmp_path / "angles.txt"), load_rig(tmp_path / "matrix.txt")
    assert list(one) == ["cam1", "cam2"]
    assert misfit(one["cam2"], other["cam2"]) < 1e-8
    assert np.allclose(one["cam2"].T, 1e-3 * np.array(T))
    assert "first camera" in one.provenance["imported"]["left_out"]


def test_dices_odd_radial_terms(tmp_path):
    outer = [0.0, 0.0, 0.0, 100.0, 0.0, 0.0]
    (tmp_path / "scale.txt").write_text(dice_text(outer, (0.02, 0.0, -0.1)))
    camera = load_rig(tmp_path / "scale.txt")["cam1"]
    a, b = 0.1, 0.05
    r = np.hypot(a, b)
    factor = 1 + 0.02 - 0.1 * r**2  # k1 r + k2 r^2 + k3 r^3 added to r
    X, Y = camera.project(a, b, 1.0)
    assert abs(X - (2400 * a * factor - 0.2 * b * factor + 600)) < 1e-9
    assert abs(Y - (2410 * b * factor + 400)) < 1e-9
    (tmp_path / "odd.txt").write_text(dice_text(outer, (0.0, 0.1, 0.0)))
    with pytest.raises(RigError, match="OPENCV_LENS_DISTORTION"):
        load_rig(tmp_path / "odd.txt")


def test_a_metashape_chunk_with_a_scale_and_a_turn(tmp_path):
    camera = random_camera(5, "tau_x", "tau_y")
    save_rig(Rig({"cam1": camera}), tmp_path / "cams.xml", "metashape")
    turn = rotation_about([0.3, -0.2, 0.5])
    chunk = (
        "<transform><rotation>" + " ".join(map(repr, turn.ravel().tolist())) + "</rotation>"
        "<translation>1.0 2.0 3.0</translation><scale>2.5</scale></transform>"
    )
    text = (tmp_path / "cams.xml").read_text().replace("</cameras>", "</cameras>" + chunk)
    (tmp_path / "cams.xml").write_text(text)
    moved = load_rig(tmp_path / "cams.xml")["cam1"]
    points = np.stack(field(5))
    there = 2.5 * turn @ points + np.array([[1.0], [2.0], [3.0]])
    for a, b in zip(camera.project(*points), moved.project(*there), strict=True):
        assert np.abs(a - b).max() < 1e-8


def test_metashape_on_the_globe_is_refused(tmp_path):
    save_rig(Rig({"cam1": random_camera(5, "tau_x", "tau_y")}), tmp_path / "cams.xml", "metashape")
    far = "<transform><translation>4.2e6 1.7e5 4.7e6</translation></transform>"
    text = (tmp_path / "cams.xml").read_text().replace("</cameras>", "</cameras>" + far)
    (tmp_path / "cams.xml").write_text(text)
    with pytest.raises(RigError, match="local coordinates"):
        load_rig(tmp_path / "cams.xml")


def test_colmaps_shorter_models(tmp_path):
    (tmp_path / "images.txt").write_text(
        "1 1 0 0 0 0.5 0 0 7 run1/a.png\n10 20 -1\n2 1 0 0 0 1 0 0 7 run1/b.png\n\n"
    )
    (tmp_path / "cameras.txt").write_text("# comment\n7 SIMPLE_RADIAL 640 480 500 320 240 0.1\n")
    rig = load_rig(tmp_path, unit="2.0")
    assert list(rig) == ["a", "b"]
    camera = rig["b"]
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.k1) == (500.0, 500.0, 319.5, 239.5, 0.1)
    assert np.allclose(camera.T, [2.0, 0.0, 0.0])
    (tmp_path / "cameras.txt").write_text("7 THIN_PRISM_FISHEYE 640 480 500 500 320 240 0 0 0 0\n")
    with pytest.raises(RigError, match="THIN_PRISM_FISHEYE"):
        load_rig(tmp_path)


@pytest.mark.parametrize("program", LACKING)
def test_the_command_writes_and_never_over_a_file(tmp_path, program):
    camera = square(random_camera(1, *LACKING[program]))
    Rig({"cam1": camera}).save(tmp_path / "rig.yaml")
    words = [str(tmp_path / "rig.yaml"), "--to", program, "-o", str(tmp_path / "out")]
    assert CliRunner().invoke(command, words).exit_code == 0
    again = CliRunner().invoke(command, words)
    assert again.exit_code != 0
    assert "exists and is not" in str(again.exception)


@pytest.mark.parametrize("cut", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("program", LACKING)
def test_a_file_that_is_cut_ends_in_one_sentence(tmp_path, program, cut):
    camera = square(random_camera(1, *LACKING[program]))
    path = tmp_path if program in FOLDERS else tmp_path / "rig.xml"
    save_rig(Rig({"cam1": camera}), path, program)
    for file in [p for p in tmp_path.rglob("*") if p.is_file()]:
        text = file.read_text()
        file.write_text(text[: int(cut * len(text))])
    with pytest.raises(RigError) as error:
        load_rig({"cam1": tmp_path / "cam1"} if program == "myptv" else path)
    assert "\n" not in str(error.value)
