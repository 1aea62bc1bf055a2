"""A simulated experiment is complete, exact and independent of the number of threads; and plans."""

import numpy as np
import pytest
import xarray as xr

import wavefield as wf
from wavefield import variables
from wavefield.errors import ExperimentError
from wavefield.images import read_image
from wavefield.rig import Rig
from wavefield.series import Experiment
from wavefield.tank import Scene, Tank, simulate

SCENE = Scene.load("demo").with_(
    frames=4,
    rig={"crop": 0.12},
    grid={"x": (-0.08, 0.08), "y": (-0.06, 0.06), "step": 0.02},
    sea={"shortest": 0.2, "period": 2.0},
    calibration={"tilted": 2},
    probes={"noise": 0.0},
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    calls = []
    directory = tmp_path_factory.mktemp("tank") / "one"
    path = simulate(SCENE, directory, lambda done, total: calls.append((done, total)))
    assert path == directory / "experiment.yaml"
    assert [done for done, _ in calls] == list(range(1, len(calls) + 1))
    assert {total for _, total in calls} == {len(calls)}
    return directory


def test_folder_is_what_a_laboratory_would_have(folder):
    for camera in ("cam1", "cam2", "cam3"):
        assert sorted(p.name for p in (folder / camera).iterdir()) == [f"img_{i:05d}.tif" for i in range(4)]
        calib = sorted(p.name for p in (folder / "calib" / camera).iterdir())
        assert calib == ["flat.tif", "tilt_0.tif", "tilt_1.tif"]
    experiment = Experiment.load(folder / "experiment.yaml")
    assert experiment.frame_rate == 20.0
    assert list(experiment.cameras) == ["cam1", "cam2", "cam3"]
    assert experiment.surface.pairs == [("cam3", "cam1"), ("cam3", "cam2")]
    assert experiment.velocity.cameras == ["cam1", "cam2"]
    assert experiment.rig is None  # it has to be calibrated
    assert Scene.load(folder / "scene.yaml") == SCENE


def test_images_are_those_of_the_tank(folder):
    images = Tank(SCENE).render(2)
    for name, image in images.items():
        assert np.array_equal(read_image(folder / name / "img_00002.tif"), image)


def test_truth_is_exact_and_carries_the_schema_of_the_cube(folder):
    ds = xr.open_zarr(folder / "truth" / "truth.zarr")
    variables.validate(ds, "z", "z_t", "u", "v", "w")
    assert ds.sizes == {"time": 3, "y": 7, "x": 9}
    assert ds.time.values == pytest.approx([0.025, 0.075, 0.125])
    tank = Tank(SCENE)
    exact = tank.sea.on_grid(ds.x.values, ds.y.values, 0.075)
    for name in ("z", "u", "v", "w"):
        assert ds[name].values[1] == pytest.approx(exact[name], abs=1e-7)
    ends = [tank.sea.on_grid(ds.x.values, ds.y.values, t, ("z",))["z"] for t in (0.05, 0.10)]
    assert ds.z_t.values[1] == pytest.approx((ends[1] - ends[0]) / 0.05, abs=1e-6)
    assert ds.z_start.values[1] == pytest.approx(ends[0], abs=1e-8)
    residual = ds.w - ds.z_rate - ds.u * ds.z.differentiate("x") - ds.v * ds.z.differentiate("y")
    assert float(abs(residual.isel(x=slice(1, -1), y=slice(1, -1))).max()) < 0.1 * float(abs(ds.w).max())
    assert ds.dx.attrs["units"] == "m"
    rig = Rig.load(folder / "truth" / "rig.yaml")
    assert dict(rig.cameras) == dict(tank.rig.cameras)


def test_probes_are_true_and_keep_their_own_time(folder):
    lines = (folder / "probes.csv").read_text().splitlines()
    assert lines[0] == "time,probe1,probe2"
    data = np.loadtxt(lines[1:], delimiter=",")
    assert np.diff(data[:, 0]) == pytest.approx(0.01)
    sea = SCENE.build_sea()
    for row in data[::5]:
        assert row[1] == pytest.approx(sea.at(-0.25, 0.1, row[0], ("z",))["z"], abs=1e-6)


def test_files_do_not_depend_on_the_number_of_workers(folder, tmp_path):
    simulate(SCENE, tmp_path / "alone", workers=1)
    files = sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    assert files == sorted(
        p.relative_to(tmp_path / "alone") for p in (tmp_path / "alone").rglob("*") if p.is_file()
    )
    for file in files:
        assert (folder / file).read_bytes() == (tmp_path / "alone" / file).read_bytes(), file


def test_nothing_is_overwritten(folder):
    with pytest.raises(ExperimentError, match="not empty"):
        simulate(SCENE, folder)


def test_chessboard_16_bit_and_two_cameras_make_an_experiment_too(tmp_path):
    rig = SCENE.build_rig()
    Rig({"left": rig["cam1"], "right": rig["cam2"]}).save(tmp_path / "pair.yaml")
    scene = SCENE.with_(
        frames=1,
        rig={"file": str(tmp_path / "pair.yaml")},
        light={"bits": 16},
        calibration={
            "target": {"kind": "chessboard", "mesh": 0.02, "shape": (5, 4)},
            "tilted": 1,
            "level": 0.015,
        },
    )
    simulate(scene, tmp_path / "two", workers=1)
    experiment = Experiment.load(tmp_path / "two" / "experiment.yaml")
    target = {"kind": "chessboard", "mesh": 0.02, "shape": [5, 4], "origin": [-0.04, -0.03]}
    assert experiment.calibration.target == target
    assert experiment.velocity.cameras == ["left", "right"]
    assert experiment.water.level == -0.015  # the water is below the target
    assert read_image(tmp_path / "two" / "left" / "img_00000.tif").dtype == np.uint16
    assert not (tmp_path / "two" / "truth" / "truth.zarr").exists()  # one frame makes no step


SMALL = {"rig": {"crop": 0.16}, "grid": {"x": (-0.1, 0.1), "y": (-0.07, 0.07), "step": 0.01}}


def test_a_plan_states_errors_and_noise_makes_them_larger():
    plain = wf.plan(**SMALL)
    noisy = wf.plan(**SMALL, light={"read_noise": 6.0, "shot_noise": 0.4})
    assert list(plain.quantity.values) == ["z", "u dt", "v dt", "w dt"]
    assert (plain.error < 0.1).all()
    assert (noisy.error > 1.2 * plain.error).all()
    assert (noisy.stated > plain.stated).all()
    assert float(plain.measured) > 0.95
    assert plain.attrs["pixel_size"] == pytest.approx(1.8e-3, rel=0.2)


def test_a_plan_takes_other_cameras_and_refuses_unknown_settings():
    rig = wf.Scene.load("demo").with_(rig={"crop": 0.16}).build_rig()
    assert (wf.plan(rig=rig, grid=SMALL["grid"]).error < 0.1).all()
    with pytest.raises(ExperimentError, match="beeds"):
        wf.plan(beeds=3)
