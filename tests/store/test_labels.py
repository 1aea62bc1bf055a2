"""Name and water are labels: changing them updates the cube, and no step is measured again."""

import shutil

import numpy as np
import pytest
import xarray as xr
from cube_cases import HERE, different

from wavefield.errors import StoreError
from wavefield.images import read_image, write_image
from wavefield.pipeline import chunk, open_cube, run


@pytest.fixture
def cube(own_tank, reference, monkeypatch):
    """The cube of the small tank next to its experiment file; measuring a step would fail the test."""
    for path in reference.parent.glob("cube*"):
        copy = shutil.copytree if path.is_dir() else shutil.copy
        copy(path, own_tank.parent / path.name)

    def never(*_):
        raise AssertionError("a step was measured again")

    monkeypatch.setattr(chunk, "measure_chunk", never)
    return own_tank.parent / "cube.zarr"


def change(path, *pairs):
    text = path.read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)


LABELS = (
    ("depth: 0.7", "depth: 0.65"),
    ("small-", "large "),
    ("frame_rate:", "description: a second look\nframe_rate:"),
)


def test_changed_labels_relabel_a_cube(own_tank, cube, reference):
    before = open_cube(reference).load()
    change(own_tank, *LABELS)
    run(own_tank, workflow=HERE)
    after = open_cube(cube).load()
    assert all(before[name].variable.equals(after[name].variable) for name in before.variables)
    assert after.attrs["water_depth"] == after.w.attrs["water_depth"] == 0.65
    assert after.attrs["experiment"] == "large tank"
    assert after.attrs["description"] == "a second look"
    assert after.wavefield.recipe == before.wavefield.recipe
    assert "label changed, nothing is measured again: experiment" in (cube.parent / "cube.log").read_text()
    assert xr.open_zarr(cube).attrs["water_depth"] == 0.65  # by stock readers alike
    change(own_tank, *(pair[::-1] for pair in LABELS))
    run(own_tank, workflow=HERE)
    assert not different(cube, reference)


@pytest.mark.parametrize(
    ("old", "new", "entry"),
    [
        ('cam1/img_{frame:05d}.tif"', 'cam1/img_{frame:05d}.tif", offset: 1', "images.cam1"),
        ("frame_rate: 20.0", "frame_rate: 25.0", "frame_rate: 20.0 there, 25.0 here"),
    ],
)
def test_what_values_depend_on_is_no_label(own_tank, cube, old, new, entry):
    change(own_tank, (old, new))
    with pytest.raises(StoreError, match=rf"another recipe \(.*{entry}"):
        run(own_tank, workflow=HERE)


def test_other_images_under_the_same_names_are_refused(own_tank, cube):
    path = own_tank.parent / "cam2" / "img_00008.tif"
    write_image(path, np.ascontiguousarray(read_image(path)[:, ::-1]))
    with pytest.raises(StoreError, match=r"begun with other images: cam2 frame 8 .*has changed"):
        run(own_tank, workflow=HERE)


def test_nothing_is_written_where_nothing_changed(own_tank, cube, monkeypatch):
    run(own_tank, workflow=HERE)  # the place of the file is a label as well
    monkeypatch.setattr("wavefield.store.write_cube.update_metadata", lambda *_: pytest.fail("written"))
    run(own_tank, workflow=HERE)
