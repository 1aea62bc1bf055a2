"""The cube that a page shows: stored and derived fields, and the thinned preview."""

import shutil

import numpy as np
import pytest
from explorer_cases import make_cube, write_cube_block

from wavefield.explorer.record import CubeRecord
from wavefield.figures.display import DERIVED
from wavefield.pipeline import open_cube
from wavefield.waves import kinematics


@pytest.fixture
def cube(tmp_path):
    path = tmp_path / "cube.zarr"
    return path, make_cube(path, ny=50, nx=60)


@pytest.mark.parametrize("harm", ["damaged", "in the way"])
def test_a_cube_without_a_sound_preview_shows_the_same(cube, harm):
    path, _ = cube
    written = CubeRecord(path)
    written.preview.load()
    chunk = path / "preview/fields/c/0/0/0/1"
    if harm == "damaged":
        chunk.write_bytes(chunk.read_bytes()[::-1])
    else:
        shutil.rmtree(path / "preview")
    if harm == "in the way":
        (path / "preview").write_text("in the way")
    record = CubeRecord(path)
    record.preview.load()
    assert np.array_equal(record.preview.fields, written.preview.fields)


def test_a_block_that_is_measured_again_is_read_again(tmp_path):
    from wavefield.store.write_cube import reset_chunks

    path = tmp_path / "cube.zarr"
    make_cube(path)
    record = CubeRecord(path)
    record.preview.load()
    before = record.preview.series("w", 5, 5)
    field = record.field("w", 41)
    reset_chunks(path, [40])
    record.refresh()
    record.preview.load()
    write_cube_block(path, 40, seed=7)
    record.refresh()
    record.preview.load()
    after = record.preview.series("w", 5, 5)
    changed = ~np.isclose(before, after, equal_nan=True)
    assert changed[40:80].any()
    assert not changed[:40].any()
    assert not np.array_equal(field, record.field("w", 41), equal_nan=True)


def test_fields_are_those_of_the_cube_and_derived_ones_those_of_the_analysis(tmp_path):
    path = tmp_path / "cube.zarr"
    fields = make_cube(path)
    record = CubeRecord(path)
    for name in record.stored:
        np.testing.assert_array_equal(record.field(name, 17), fields[name][17])
    expected = kinematics(open_cube(path).load(), current=(0.0, 0.0))
    for name in DERIVED:
        for step in (0, 41, 119):
            derived = expected[name].values[step]
            np.testing.assert_allclose(record.field(name, step), derived, rtol=1e-4, atol=1e-6)
