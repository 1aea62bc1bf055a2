"""Backgrounds: averaged by the command, subtracted where the experiment file names them."""

import numpy as np
import pytest

from wavefield.commands.cli import main
from wavefield.errors import ExperimentError
from wavefield.images import read_image, write_image
from wavefield.series import Experiment
from wavefield.series.backgrounds import checksums, mean_image
from wavefield.store.recipe import Recipe

SHAPE = 40, 60


@pytest.fixture
def folder(tmp_path):
    """An experiment of two cameras with a floor under moving beads; its frames by camera."""
    draws, frames = np.random.default_rng(5), {}
    for name in ("cam1", "cam2"):
        floor = draws.integers(20, 120, SHAPE)
        beads = [np.where(draws.random(SHAPE) > 0.97, 100, 0) for _ in range(12)]
        frames[name] = floor, beads
        for k, bead in enumerate(beads):
            write_image(tmp_path / name / f"img_{k:05d}.tif", (floor + bead).astype(np.uint8))
    (tmp_path / "experiment.yaml").write_text(
        "name: tank\nframe_rate: 20\ncameras:\n"
        '  cam1: "cam1/img_{frame:05d}.tif"\n  cam2: "cam2/img_{frame:05d}.tif"\n'
    )
    return tmp_path, frames


def test_the_command_averages_and_the_experiment_subtracts(folder, capsys):
    path, frames = folder
    file = path / "experiment.yaml"
    assert main(["background", str(path)]) == 0
    words = capsys.readouterr().out
    key = next(line.strip() for line in words.splitlines() if line.startswith("  background:"))
    file.write_text(f"{file.read_text()}{key}\n")
    series = Experiment.load(file).open_frames()
    for name, (floor, beads) in frames.items():
        mean = np.rint(floor + np.mean(beads, axis=0)).astype(np.uint8)
        np.testing.assert_array_equal(read_image(path / "background" / f"{name}.tif"), mean)
        for k, bead in enumerate(beads):
            read = series[name].read(k).image
            assert read.dtype == np.uint8
            np.testing.assert_array_equal(read, np.maximum((floor + bead) - mean.astype(int), 0))
            assert np.corrcoef(read.ravel(), bead.ravel())[0, 1] > 0.98
            assert np.corrcoef((floor + bead).ravel(), bead.ravel())[0, 1] < 0.7
            np.testing.assert_array_equal(series[name].window(k, k + 1).read(0).image, read)
    capsys.readouterr()
    assert main(["background", str(file), "--frames", "4"]) == 0  # of the frames as they are
    assert "add this line" not in capsys.readouterr().out
    mean = np.rint(frames["cam1"][0] + np.mean([frames["cam1"][1][k] for k in (1, 4, 7, 10)], axis=0))
    np.testing.assert_array_equal(read_image(path / "background" / "cam1.tif"), mean)


def test_frames_that_cannot_be_read_are_left_out_of_the_mean(folder):
    path, frames = folder
    (path / "cam1" / "img_00003.tif").write_bytes(b"nonsense")
    series = Experiment.load(path / "experiment.yaml").open_frames()["cam1"]
    floor, beads = frames["cam1"]
    kept = [bead for k, bead in enumerate(beads) if k != 3]
    np.testing.assert_array_equal(mean_image(series, 12), np.rint(floor + np.mean(kept, axis=0)))


def test_a_background_that_is_absent_or_of_other_images_is_refused_with_the_command(folder):
    path, _ = folder
    file = path / "experiment.yaml"
    file.write_text(file.read_text() + 'background: "background/{camera}.tif"\n')
    with pytest.raises(ExperimentError, match=r"`wavefield background experiment\.yaml` writes it"):
        Experiment.load(file).open_frames()
    for image in (np.zeros((3, 4), np.uint8), np.zeros(SHAPE, np.uint16)):
        image.flat[0] = 1
        for name in ("cam1", "cam2"):
            write_image(path / "background" / f"{name}.tif", image)
        with pytest.raises(ExperimentError, match=r"frames of cam1 are 60 x 40 uint8; run"):
            Experiment.load(file).open_frames()


def test_the_recipe_changes_with_a_background_and_not_without(folder):
    path, _ = folder
    main(["background", str(path)])
    file = path / "experiment.yaml"
    bare = Experiment.load(file).open_frames()
    file.write_text(file.read_text() + "background: {cam1: background/cam1.tif}\n")
    series = Experiment.load(file).open_frames()
    assert checksums(bare) == {}
    assert list(checksums(series)) == ["cam1"]
    plain, one = recipe(checksums(bare)), recipe(checksums(series))
    assert plain.hash == Recipe("tank", {}, (0, 11), 20.0, {}, {}, {}).hash
    write_image(path / "background" / "cam1.tif", series["cam1"].background + np.uint8(1))
    other = recipe(checksums(Experiment.load(file).open_frames()))
    assert len({plain.hash, one.hash, other.hash}) == 3


def recipe(background):
    return Recipe("tank", {}, (0, 11), 20.0, {}, {}, {}, background=background)
