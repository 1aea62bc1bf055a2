"""The cube behind a page: its fields, derived ones too, and the thinned preview beside it."""

import shutil

import numpy as np
import pytest
from explorer_cases import create_cube, make_cube, write_cube_block

from wavefield.errors import StoreError
from wavefield.explorer.record import CubeRecord
from wavefield.figures.display import DERIVED
from wavefield.pipeline import open_cube
from wavefield.store.preview import open_preview, preview_path, thinning
from wavefield.store.read import open_group
from wavefield.waves.motion import kinematic_fields


@pytest.fixture
def cube(tmp_path):
    path = tmp_path / "cube.zarr"
    return path, make_cube(path, ny=50, nx=60)


def test_the_preview_holds_every_second_node_of_a_cube_of_3000(cube):
    path, fields = cube
    group = open_group(path)
    preview = open_preview(path, group)
    thin = thinning(group)
    assert thin.every == 2
    for k, (name, scale) in enumerate(zip(thin.names, thin.scales)):
        stored = np.asarray(preview["fields"][k]).astype(float)
        values = np.where(stored == -32768, np.nan, stored * scale)
        expected = np.moveaxis(fields[name][:, ::2, ::2], 0, -1)
        np.testing.assert_allclose(values, expected, atol=0.51 * scale, rtol=1e-6, err_msg=name)
    assert np.asarray(preview["done"][:]).all()


def test_a_cube_without_a_preview_gets_the_same_one_on_first_look(cube, tmp_path):
    path, _ = cube
    bare = tmp_path / "bare" / "cube.zarr"
    shutil.copytree(path, bare)
    shutil.rmtree(preview_path(bare))
    reported = []
    record = CubeRecord(bare)
    record.preview.load(lambda done, total: reported.append((done, total)))
    written = CubeRecord(path)
    written.preview.load()
    assert reported == [(1, 3), (2, 3), (3, 3)]
    assert np.array_equal(record.preview.fields, written.preview.fields)
    again = CubeRecord(bare)
    preview = open_preview(bare, again.group)
    assert preview is not None
    assert np.asarray(preview["done"][:]).all()


def test_a_cube_that_is_being_written_is_read_as_far_as_it_is(tmp_path):
    path = tmp_path / "cube.zarr"
    create_cube(path)
    write_cube_block(path, 40)
    record = CubeRecord(path)
    record.preview.load()
    assert record.first_step() == 40
    assert record.preview.loaded.tolist() == [False, True, False]
    assert np.isnan(record.preview.series("z", 5, 5)[:40]).all()
    assert not record.refresh()
    write_cube_block(path, 0)
    assert record.refresh()
    record.preview.load()
    assert np.isfinite(record.preview.series("z", 5, 5)[:80]).all()


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


def test_a_preview_that_cannot_be_kept_is_a_sentence_and_memory_has_it_all(tmp_path):
    path = tmp_path / "cube.zarr"
    fields = make_cube(path, preview=False)
    preview_path(path).write_text("in the way")
    record = CubeRecord(path)
    record.preview.load()
    assert "preview" in record.preview.trouble
    np.testing.assert_allclose(record.preview.series("z", 6, 6), fields["z"][:, 6, 6], atol=5.1e-6)


def test_fields_are_those_of_the_cube_and_derived_ones_those_of_the_analysis(tmp_path):
    path = tmp_path / "cube.zarr"
    fields = make_cube(path)
    record = CubeRecord(path)
    for name in record.stored:
        np.testing.assert_array_equal(record.field(name, 17), fields[name][17])
    expected = kinematic_fields(open_cube(path).load())
    for name in DERIVED:
        for step in (0, 41, 119):
            derived = expected[name].values[step]
            np.testing.assert_allclose(record.field(name, step), derived, rtol=1e-4, atol=1e-6)


def test_half_a_cube_is_a_sentence_that_names_what_is_missing(tmp_path):
    half = tmp_path / "cube.zarr"
    make_cube(half)
    shutil.rmtree(half / "u" / "c" / "1")
    record = CubeRecord(half)
    assert np.isfinite(record.field("u", 3)).any()
    with pytest.raises(StoreError, match=r"u/c/1/0/0 is missing.*copy the cube again"):
        record.field("u", 50)
