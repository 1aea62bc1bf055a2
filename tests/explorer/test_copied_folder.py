"""A folder that was copied, moved or renamed is shown with its own experiment file."""

import json
import shutil

import numpy as np
import pytest
from explorer_cases import make_cube

from wavefield.images import write_image
from wavefield.pipeline import open_run
from wavefield.pipeline.opened_run import fingerprints, image_names, labels
from wavefield.series import Experiment

PLACES = ["cube.zarr", "1a2b3c4d/cube.zarr"]


def write_experiment(folder, seed=1, more=""):
    rng = np.random.default_rng(seed)
    for number in range(4):
        image = rng.integers(0, 255, (20, 30)).astype(np.uint8)
        write_image(folder / "left" / f"img_{number:05d}.tif", image)
    path = folder / "experiment.yaml"
    path.write_text(f'name: tank\nframe_rate: 20\ncameras: {{left: "left/img_{{frame:05d}}.tif"}}\n{more}')
    return path


def measured(folder, place="cube.zarr", **changed):
    """Make a cube of the experiment in a folder, with the attributes that a run writes."""
    experiment = Experiment.load(folder / "experiment.yaml")
    store = folder / place
    store.parent.mkdir(exist_ok=True)
    recipe = json.dumps({"images": {"left": image_names(experiment, "left")}, "experiment": "tank"})
    begun = json.dumps(fingerprints(experiment.open_frames()))
    attributes = labels(experiment, store) | {"recipe": recipe, "fingerprints": begun} | changed
    make_cube(store, preview=False, **attributes)
    return store


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("way", ["copied", "moved"])
def test_a_folder_elsewhere_has_its_own_experiment(tmp_path, place, way):
    first, second = tmp_path / "first", tmp_path / "deeper" / "second"
    write_experiment(first, more="folder: .\n")
    measured(first, place)
    (shutil.copytree if way == "copied" else shutil.move)(first, second)
    run = open_run(second / place)
    assert run.experiment.path == second / "experiment.yaml"
    assert run.experiment.image_folder.resolve() == second


def test_a_cube_that_names_an_absolute_path_prefers_the_file_beside_it(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    path = write_experiment(first)
    measured(first, experiment_file=str(path))
    assert open_run(first / "cube.zarr").experiment.path == path
    shutil.copytree(first, second)
    assert open_run(second / "cube.zarr").experiment.path == second / "experiment.yaml"


def test_a_link_to_the_folder_of_a_cube_finds_its_experiment(tmp_path):
    path = write_experiment(tmp_path / "run")
    measured(tmp_path / "run", "1a2b3c4d/cube.zarr")
    (tmp_path / "run" / "latest").symlink_to("1a2b3c4d")
    assert open_run(tmp_path / "run" / "latest" / "cube.zarr").experiment.path == path


def test_the_experiment_of_other_images_beside_a_cube_is_not_taken(tmp_path):
    write_experiment(tmp_path / "first")
    store = measured(tmp_path / "first")
    write_experiment(tmp_path / "second", seed=2)
    shutil.copytree(store, tmp_path / "second" / "cube.zarr")
    run = open_run(tmp_path / "second" / "cube.zarr")
    assert run.experiment is None
    assert "begun with other images" in run.reason("experiment")


def test_images_that_are_gone_leave_the_experiment(tmp_path):
    path = write_experiment(tmp_path / "run")
    store = measured(tmp_path / "run")
    shutil.rmtree(tmp_path / "run" / "left")
    assert open_run(store).experiment.path == path
