"""The small tank, its cube and its waves: made once per session, whatever the number of workers."""

import functools
import hashlib
import os
import pickle
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
from cube_cases import FOURS, HERE, KNOCKED, linear_sea, write_tank
from filelock import FileLock


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """A folder that the first worker to ask for it fills; the others wait for it. Not to be changed."""
    base = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent
    folder = base / f"once-{name}"
    with FileLock(base / f"once-{name}.lock"):
        if not folder.with_suffix(".done").exists():
            shutil.rmtree(folder, ignore_errors=True)  # of one that failed
            folder.mkdir()
            make(folder)
            folder.with_suffix(".done").touch()
    return folder


LEARNED = {}  # what was computed from the same inputs


def _remembered(compute):
    """The same function, which computes once what it is asked for twice."""

    @functools.wraps(compute)
    def remembered(*given, **named):
        inputs = compute.__name__, *map(_input, given), *named.items()
        # each on its own: a pickle of all would depend on which objects they share
        key = hashlib.sha256(b"".join(map(pickle.dumps, inputs))).digest()
        if key not in LEARNED:
            LEARNED[key] = compute(*given, **named)
        return LEARNED[key]

    return remembered


def _input(one):
    """What an input is made of: geometries and models also keep what they have computed so far."""
    from wavefield.measurement import GridGeometry, Model

    if isinstance(one, Model):
        return one.record
    if isinstance(one, GridGeometry):
        return one.rig, one.grid, one.settings, one.covered
    return one


@pytest.fixture(scope="session", autouse=True)
def learned_once():
    """Spectra, noise and errors of pairs of the same frames are computed once for all runs: half of a run."""
    import wavefield.measurement
    import wavefield.pipeline.assess
    from wavefield.matching import map_variance
    from wavefield.measurement import search_range

    with pytest.MonkeyPatch.context() as patch:
        for module, name in (
            (wavefield.measurement, "learn"),
            (wavefield.pipeline.assess, "diagnose"),
            (map_variance, "hole_variance"),
            (search_range, "shifts"),
        ):
            patch.setattr(module, name, _remembered(getattr(module, name)))
        yield


@pytest.fixture(scope="session")
def tank(tmp_path_factory):
    """Experiment file of the small tank; not to be changed."""
    return once(tmp_path_factory, "tank", write_tank) / "experiment.yaml"


@pytest.fixture
def own_tank(tank, tmp_path):
    """A copy of it that a test may spoil."""
    shutil.copytree(tank.parent, tmp_path / "tank")
    return tmp_path / "tank" / "experiment.yaml"


@pytest.fixture(scope="session")
def reference(tank, tmp_path_factory):
    """Its cube from one uninterrupted run in one block."""

    def make(folder):
        from wavefield.pipeline import run

        run(tank, out=folder / "cube.zarr", workflow=HERE)

    return once(tmp_path_factory, "reference", make) / "cube.zarr"


@pytest.fixture(scope="session")
def knocked(tmp_path_factory):
    """A wider tank whose cam1 turns by .01 degrees in mid-record; not to be changed."""
    return once(tmp_path_factory, "knocked", _write_knocked) / "experiment.yaml"


def _write_knocked(folder):
    from wavefield.images import write_image
    from wavefield.tank import Scene, Tank

    fault = {"cam1": {"turned": (0.01, 0.0, 0.0), "since": KNOCKED}}
    tank = Tank(Scene.load("demo").with_(rig={"crop": 0.25}, sea={"shortest": 0.15}, faults=fault))
    tank.rig.save(folder / "rig.yaml")
    for frame in range(11):
        for name, image in tank.render(frame).items():
            write_image(folder / name / f"img_{frame:02d}.tif", image)
    cameras = "".join(f'  {name}: "{name}/img_{{frame}}.tif"\n' for name in tank.rig)
    grid = "grid: {x: [-0.15, 0.15], y: [-0.1, 0.1], step: 0.01}\n"
    note = f"name: lab\nframe_rate: 20\nrig: rig.yaml\ncameras:\n{cameras}{grid}"
    (folder / "experiment.yaml").write_text(note)


@pytest.fixture(scope="session")
def measured(tmp_path_factory):
    """A folder with a tiny experiment, its cube of three blocks, preview, verdict and waves."""

    def make(folder):
        from wavefield import analyze
        from wavefield.pipeline import run

        run(write_tank(folder, 10), workflow=FOURS)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            analyze(folder / "cube.zarr", folder / "waves.zarr", segment=8)

    return once(tmp_path_factory, "measured", make)


@pytest.fixture(scope="session")
def cube():
    """A small cube of an exact linear sea, in memory; not to be changed."""
    return linear_sea()
