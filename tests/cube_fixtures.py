"""The small tank and its cube, made once."""

import functools
import hashlib
import pickle
import shutil
import warnings

import pytest
from cube_cases import FOURS, HERE, KNOCKED, write_tank

import wavefield.measurement
from wavefield import analyze
from wavefield.images import write_image
from wavefield.pipeline import run
from wavefield.tank import Scene, Tank

LEARNED = {}  # what was learned from the same frames, by its inputs


@pytest.fixture(scope="package", autouse=True)
def learned_once():
    """Beads, spectra and noise of the same frames are learned once for all runs: a third of a run here."""
    learn = wavefield.measurement.learn

    @functools.wraps(learn)
    def remembered(steps, geometry, masks=None, threads=1, frame_rate=None):
        place = geometry.rig, geometry.grid, geometry.settings, geometry.covered
        key = hashlib.sha256(pickle.dumps((steps, masks, frame_rate, place))).digest()
        if key not in LEARNED:
            LEARNED[key] = learn(steps, geometry, masks, threads, frame_rate)
        return LEARNED[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wavefield.measurement, "learn", remembered)
        yield


@pytest.fixture(scope="session")
def tank(tmp_path_factory):
    """Experiment file of the small tank; not to be changed."""
    return write_tank(tmp_path_factory.mktemp("tank"))


@pytest.fixture
def own_tank(tank, tmp_path):
    """A copy of it that a test may spoil."""
    shutil.copytree(tank.parent, tmp_path / "tank")
    return tmp_path / "tank" / "experiment.yaml"


@pytest.fixture(scope="session")
def reference(tank, tmp_path_factory):
    """Its cube from one uninterrupted run in one block."""
    path = tmp_path_factory.mktemp("reference") / "cube.zarr"
    run(tank, out=path, workflow=HERE)
    return path


@pytest.fixture(scope="session")
def knocked(tmp_path_factory):
    """A wider tank whose cam1 turns by .01 degrees in mid-record; not to be changed."""
    folder = tmp_path_factory.mktemp("knocked")
    fault = {"cam1": {"turned": (0.01, 0.0, 0.0), "since": KNOCKED}}
    tank = Tank(Scene.load("demo").with_(rig={"crop": 0.25}, sea={"shortest": 0.15}, faults=fault))
    tank.rig.save(folder / "rig.yaml")
    for frame in range(11):
        for name, image in tank.render(frame).items():
            write_image(folder / name / f"img_{frame:02d}.tif", image)
    cameras = "".join(f'  {name}: "{name}/*.tif"\n' for name in tank.rig)
    grid = "grid: {x: [-0.15, 0.15], y: [-0.1, 0.1], step: 0.01}\n"
    path = folder / "experiment.yaml"
    path.write_text(f"name: lab\nframe_rate: 20\nrig: rig.yaml\ncameras:\n{cameras}{grid}")
    return path


@pytest.fixture(scope="session")
def measured(tmp_path_factory):
    """A folder with a tiny experiment, its cube of three blocks, preview, verdict and waves."""
    folder = tmp_path_factory.mktemp("measured")
    experiment = write_tank(folder, 10)
    run(experiment, workflow=FOURS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        analyze(folder / "cube.zarr", folder / "waves.zarr", segment=8)
    return folder
