"""Commands accept an experiment file, its folder or its cube alike."""

import json
import subprocess
import sys

import numpy as np
import pytest

import wavefield.pipeline
from wavefield.commands.cli import main
from wavefield.commands.sources import experiment_file, find_cube
from wavefield.errors import ExperimentError, StoreError
from wavefield.images import write_image

NOTE = "name: tank\nframe_rate: 20\ncameras: {left: 'left/img_{frame}.tif', right: 'right/img_{frame}.tif'}\n"


def store(path, **attributes):
    """Make a Zarr store with the attributes that the command line reads."""
    path.mkdir(parents=True)
    (path / "zarr.json").write_text(json.dumps({"attributes": attributes}))
    return path


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "experiment.yaml").write_text(NOTE)
    (tmp_path / "rig.yaml").write_text("units: {length: m}\ncameras: {}\n")
    for name in ("left", "right"):
        for number in range(3, 15):
            write_image(tmp_path / name / f"img_{number:03d}.tif", np.full((8, 9), number, np.uint8))
    return tmp_path


@pytest.mark.parametrize("name", ["experiment.yaml", "run07.yaml"])
def test_a_folder_gives_its_experiment_file(folder, name):
    (folder / "experiment.yaml").rename(folder / name)
    assert experiment_file(folder) == folder / name
    assert experiment_file(folder / name) == folder / name


def test_a_folder_without_or_with_several_experiments_is_refused_with_the_remedy(folder, tmp_path):
    (folder / "experiment.yaml").rename(folder / "a.yaml")
    (folder / "b.yaml").write_text(NOTE)
    with pytest.raises(ExperimentError, match=r"2 experiment files: name one of a\.yaml, b\.yaml"):
        experiment_file(folder)
    with pytest.raises(ExperimentError, match="wavefield init"):
        experiment_file(folder / "left")


@pytest.mark.parametrize("name", ["cube.zarr", "run7.zarr"])
def test_a_folder_and_an_experiment_give_their_cube_not_other_stores(folder, name):
    cube = store(folder / name, recipe="{}")
    store(folder / "waves.zarr", source=str(cube))
    store(folder / "cube_preview.zarr", of="cube")
    assert find_cube(cube) == cube
    assert find_cube(folder) == cube
    if name == "cube.zarr":
        assert find_cube(folder / "experiment.yaml") == cube


def test_a_folder_of_several_cubes_or_of_none_is_refused_with_the_remedy(folder):
    with pytest.raises(StoreError, match=r"wavefield run .*experiment\.yaml"):
        find_cube(folder)
    store(folder / "a.zarr", recipe="{}")
    store(folder / "b.zarr", recipe="{}")
    with pytest.raises(StoreError, match=r"2 cubes: name one of a\.zarr, b\.zarr"):
        find_cube(folder)


@pytest.fixture
def given(monkeypatch):
    """Experiment and store of each run that the command line starts; nothing is measured."""
    calls = []

    def run(experiment, out, **how):
        calls.append((experiment, out))
        raise StoreError("enough")

    monkeypatch.setattr(wavefield.pipeline, "run", run)
    return calls


@pytest.mark.parametrize(("words", "kept"), [("0:7", (3, 7)), ("5:50", (5, 14)), ("4:5", (4, 5))])
def test_a_trial_measures_some_frames_into_a_cube_of_its_own(folder, given, words, kept):
    assert main(["-q", "run", str(folder), "--frames", words]) == 1
    experiment, out = given[0]
    series = experiment.open_frames()["left"]
    assert (series.first, series.first + len(series) - 1) == kept
    assert out == folder / f"cube_{kept[0]}_{kept[1]}.zarr"


def test_a_trial_of_frames_that_are_not_there_is_refused(folder, given, capsys):
    assert main(["-q", "run", str(folder), "--frames", "20:50"]) == 1
    assert "has the frames 3 to 14; name some of these" in capsys.readouterr().err
    assert main(["-q", "run", str(folder), "--frames", "5"]) == 2
    assert "write FIRST:LAST" in capsys.readouterr().err
    assert not given


def test_words_are_completed_by_the_shell():
    code = "import sys; from wavefield.commands.cli import main; sys.exit(main([]))"
    shell = {"_WAVEFIELD_COMPLETE": "bash_complete", "COMP_WORDS": "wavefield cal", "COMP_CWORD": "1"}
    found = subprocess.run([sys.executable, "-c", code], env=shell, capture_output=True, text=True)
    assert found.stdout == "plain,calibrate\n"
