"""Images in object stores, by way of Zarr: one in memory represents them all."""

import fsspec
import numpy as np
import pytest
import zarr
from series_cases import HEAD, number_image

from wavefield.errors import ExperimentError
from wavefield.series import Experiment
from wavefield.series.readers import close_files, read_entry


@pytest.fixture(autouse=True)
def _store():
    array = zarr.create_array("memory://lab/cam1.zarr", shape=(5, 6, 8), dtype="u1", chunks=(1, 6, 8))
    array[:] = np.stack([number_image(k) for k in range(5)])
    yield
    fsspec.filesystem("memory").rm("/lab", recursive=True)
    close_files()


def open_frames(folder, images):
    (folder / "experiment.yaml").write_text(HEAD + f"  cam1: {{images: '{images}'}}\n")
    return Experiment.load(folder / "experiment.yaml").open_frames()


def test_a_zarr_array_of_images_is_read_in_place(tmp_path):
    series = open_frames(tmp_path, "memory://lab/{camera}.zarr")
    np.testing.assert_array_equal(series["cam1"].read(3).image, number_image(3))
    np.testing.assert_array_equal(read_entry(series["cam1"].entries[1]), number_image(1))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("memory://lab/nowhere.zarr", "lab/nowhere.zarr"),
        ("nostore://lab/cam1.zarr", "is not a Zarr array"),
    ],
)
def test_what_is_not_read_is_named(tmp_path, name, words):
    with pytest.raises(ExperimentError) as reported:
        open_frames(tmp_path, name)
    assert words in str(reported.value)
    assert "\n" not in str(reported.value)
