"""The xarray engine: lazy, one header per camera, gaps as zeros with a warning."""

import pickle

import numpy as np
import pytest
import xarray as xr
from series_cases import number_image, write_experiment, write_frames

from wavefield.series import engine, frames, listing


@pytest.fixture
def experiment(tmp_path):
    write_frames(tmp_path / "cam1", range(3, 13))
    write_frames(tmp_path / "cam2", range(3, 13), shape=(10, 12))
    return write_experiment(
        tmp_path, "cam1: cam1/img_{frame}.tif\ncam2: cam2/img_{frame}.tif", "water: {depth: 0.5}\n"
    )


@pytest.fixture
def reads(monkeypatch):
    """Counts the images read."""
    seen = []

    def counting(entry):
        seen.append(entry.path)
        return real(entry)

    real = frames.read_entry
    for module in (frames, listing):
        monkeypatch.setattr(module, "read_entry", counting)
    return seen


def test_one_node_per_camera_with_times_from_frame_numbers(experiment):
    assert xr.backends.list_engines()["wavefield"].guess_can_open(experiment)
    tree = xr.open_datatree(experiment, engine="wavefield")
    assert list(tree.children) == ["cam1", "cam2"]
    assert [str(tree[name].image.camera.values) for name in tree.children] == ["cam1", "cam2"]
    assert tree["cam1"].image.dims == ("time", "row", "column")
    assert tree["cam2"].image.shape == (10, 10, 12)
    np.testing.assert_allclose(tree["cam2"].time, np.arange(3, 13) / 20.0)
    np.testing.assert_array_equal(tree.frame, np.arange(3, 13))
    assert tree.attrs == {"experiment": "basin", "frame_rate": 20.0, "water_depth": 0.5}


def test_opening_reads_one_frame_per_camera_and_nothing_else_before_it_is_needed(experiment, reads):
    tree = xr.open_datatree(experiment, engine="wavefield")
    repr(tree)
    part = tree["cam1"].image.isel(time=slice(2, 5), row=0)
    assert len(reads) == 2
    np.testing.assert_array_equal(part.values[:, 0], [5, 6, 7])
    assert len(reads) == 2 + 3


@pytest.mark.parametrize(
    "key", [np.s_[4], np.s_[1:3], np.s_[::3, 2], np.s_[[5, 1]], np.s_[-1, ::2, 3], np.s_[0:0]]
)
def test_indexing_gives_what_the_images_hold(experiment, key):
    everything = np.stack([number_image(n) for n in range(3, 13)])
    image = xr.open_datatree(experiment, engine="wavefield")["cam1"].image
    np.testing.assert_array_equal(image[key].values, everything[key])


def test_one_camera_opens_as_a_dataset(experiment):
    camera = xr.open_dataset(experiment, engine="wavefield", group="cam2", chunks={})
    assert int(camera.image[4, 0, 0]) == 7
    for group in (None, "cam9"):
        with pytest.raises(ValueError, match=r"one of its cameras as group \(cam1, cam2\)"):
            xr.open_dataset(experiment, engine="wavefield", group=group)


def test_missing_frames_are_zeros_and_a_warning(experiment):
    (experiment.parent / "cam1" / "img_00007.tif").unlink()
    tree = xr.open_datatree(experiment, engine="wavefield")
    np.testing.assert_array_equal(tree["cam1"].present, np.arange(3, 13) != 7)
    with pytest.warns(engine.FrameWarning, match="cam1 frame 7 is missing; zeros take its place"):
        image = tree["cam1"].image[4].values
    assert not image.any()
    assert int(tree["cam1"].image[5, 0, 0]) == 8


def test_lazy_images_travel_to_other_processes(experiment):
    image = xr.open_datatree(experiment, engine="wavefield")["cam1"].image
    again = pickle.loads(pickle.dumps(image[2:4]))
    np.testing.assert_array_equal(again.values[:, 0, 0], [5, 6])


def test_an_experiment_in_a_notebook_is_a_short_table(experiment):
    from wavefield.series import Experiment

    shown = Experiment.load(experiment)
    assert repr(shown) == "Experiment('basin', cam1, cam2, 20 Hz)"
    text = shown._repr_html_()
    assert all(
        part in text for part in ("Experiment basin", "cam1/img_{frame}.tif", "0.5 m", "auto", "rig.yaml")
    )
    assert text.count("<tr>") <= 12
