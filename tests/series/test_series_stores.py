"""Images and cubes in object stores, by way of fsspec: one in memory represents them all."""

import cv2
import fsspec
import numpy as np
import pytest
import zarr
from series_cases import HEAD, number_image

from wavefield.errors import ExperimentError, FrameError
from wavefield.series import Experiment
from wavefield.series.readers import close_files, read_entry


@pytest.fixture
def store():
    files = fsspec.filesystem("memory")
    yield files
    files.rm("/lab", recursive=True)
    close_files()


def put(files, name, image):
    files.pipe_file(f"/lab/{name}", cv2.imencode("." + name.rsplit(".", 1)[1], image)[1].tobytes())


def experiment(folder, cam2="memory://lab/cam2/img_{frame:05d}.png"):
    text = HEAD + '  cam1: {images: "memory://lab/{camera}/img_{frame:05d}.tif"}\n'
    (folder / "experiment.yaml").write_text(text + f'  cam2: {{images: "{cam2}"}}\n')
    return Experiment.load(folder / "experiment.yaml")


def test_images_are_listed_once_and_read_one_by_one(store, tmp_path):
    for k in (0, 1, 3, 4):
        put(store, f"cam1/img_{k:05d}.tif", number_image(k))
        put(store, f"cam2/img_{k:05d}.png", number_image(k + 100))
    series = experiment(tmp_path).open_frames()
    assert series["cam1"].missing.tolist() == [2]
    np.testing.assert_array_equal(series["cam1"].read(3).image, number_image(3))
    np.testing.assert_array_equal(series["cam2"].read(4).image, number_image(104))
    store.pipe_file("/lab/cam1/img_00004.tif", b"II*\0damaged")
    store.rm("/lab/cam1/img_00001.tif")
    assert "memory://lab/cam1/img_00004.tif is corrupt" in series["cam1"].read(4).message
    assert "memory://lab/cam1/img_00001.tif: there is nothing" in series["cam1"].read(1).message


def test_a_zarr_array_of_images_is_read_in_place(store, tmp_path):
    for k in range(5):
        put(store, f"cam1/img_{k:05d}.tif", number_image(k))
    array = zarr.create_array("memory://lab/cam2.zarr", shape=(5, 6, 8), dtype="u1", chunks=(1, 6, 8))
    array[:] = np.stack([number_image(k) for k in range(5)])
    series = experiment(tmp_path, "memory://lab/{camera}.zarr").open_frames()
    np.testing.assert_array_equal(series["cam2"].read(3).image, number_image(3))
    np.testing.assert_array_equal(read_entry(series["cam2"].entries[1]), number_image(1))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("memory://lab/nowhere/img_{frame:05d}.tif", "memory://lab/nowhere: there is nothing"),
        ("memory://lab/cam1/other_{frame:05d}.tif", "no file in memory://lab/cam1 fits"),
        ("memory://lab/cam1/{frame}_{frame}.tif", "has {frame} twice"),
        ("memory://lab/nowhere.zarr", "memory://lab/nowhere.zarr"),
        ("nostore://lab/cam1/img_{frame:05d}.tif", "cannot be reached"),
    ],
)
def test_what_cannot_be_reached_is_named(store, tmp_path, name, words):
    for k in range(3):
        put(store, f"cam1/img_{k:05d}.tif", number_image(k))
    with pytest.raises((ExperimentError, FrameError)) as reported:
        experiment(tmp_path, name).open_frames()
    assert words in str(reported.value)
    assert "\n" not in str(reported.value)
