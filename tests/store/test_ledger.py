"""The ledger is read file by file, as Zarr would read it."""

import shutil
from itertools import count

import numpy as np
import pytest
import zarr

from wavefield.errors import StoreError
from wavefield.store.checked import checksum, chunk_path, stored_bytes
from wavefield.store.layout import StoreLayout, create_store
from wavefield.store.ledger import status
from wavefield.store.ledger_files import ledger_checksum, read_ledger
from wavefield.store.metadata import WATCHED, mark_complete
from wavefield.store.recipe import Recipe
from wavefield.store.verify import verify
from wavefield.store.write_cube import write_chunk
from wavefield.variables import CUBE_FIELDS

LAYOUT = StoreLayout(47, 10, ("a", "b"), 0)


@pytest.fixture
def store(tmp_path):
    """A ledger of five chunks, of which the third is not written."""
    path, axis = tmp_path / "cube.zarr", np.linspace(0, 1, 5)
    create_store(path, Recipe("none", {}, (0, 47), 20.0, {}, {}, {}), axis, axis, LAYOUT, {})
    group, rng = zarr.open_group(path, mode="r+"), np.random.default_rng(0)
    for part in (slice(0, 20), slice(30, 47)):
        group["frame_status"][part] = rng.integers(1, 4, 47, dtype=np.uint8)[part]
    group["frame_fault"][:, 30:48] = rng.integers(0, 4, (2, 18), dtype=np.uint8)
    for chunk in (0, 1, 3, 4):
        group["checksum"][chunk] = [checksum(path, name, chunk) for name in WATCHED]
        group["stored_bytes"][chunk] = [stored_bytes(path, name, chunk) for name in WATCHED]
    return path


@pytest.mark.parametrize("name", ["frame_status", "frame_fault"])
def test_it_reads_what_zarr_reads(store, name):
    group = zarr.open_group(store, mode="r")
    values = read_ledger(store, group, name, LAYOUT)
    assert values.any()
    np.testing.assert_array_equal(values, group[name][:])


def test_of_earlier_stores_too(tmp_path):
    group = zarr.open_group(tmp_path / "old.zarr", mode="w", zarr_format=3)
    old = group.create_array("frame_status", shape=(47,), chunks=(10,), dtype="uint8", fill_value=0)
    old[:] = np.arange(47)
    np.testing.assert_array_equal(read_ledger(tmp_path / "old.zarr", group, "frame_status", LAYOUT), old[:])


def test_a_file_that_is_too_short_is_damage(store):
    path = chunk_path(store, "frame_status", 1)
    path.write_bytes(path.read_bytes()[:5])
    group = zarr.open_group(store, mode="r")
    with pytest.raises(ValueError, match="reshape"):
        read_ledger(store, group, "frame_status", LAYOUT)
    with pytest.raises(StoreError, match=r"steps 10 to 19 .*`wavefield run EXPERIMENT`"):
        status(store)


@pytest.mark.parametrize("read", [status, lambda cube: verify(cube, read=False)], ids=["status", "verify"])
def test_a_run_that_ends_while_its_cube_is_read_is_no_damage(tmp_path, monkeypatch, read):
    """Whichever file has just been opened, or found missing, when the last two chunks are written."""
    layout, axis = StoreLayout(6, 2, ("a", "b"), 0), np.arange(3) * 0.1
    create_store(tmp_path / "0", Recipe("none", {}, (0, 6), 20.0, {}, {}, {}), axis, axis, layout, {})

    def write(cube, *starts):
        for start in starts:
            fields = {name: np.ones((2, 3, 3), np.float32) for name in CUBE_FIELDS}
            write_chunk(cube, start, fields, np.ones(2, np.uint8), {})

    write(tmp_path / "0", 0)
    for moment in count():
        cube = shutil.copytree(tmp_path / "0", tmp_path / f"{moment + 1}")
        opened = count()

        def open_and_go_on(*arguments, moment=moment, cube=cube, opened=opened, **keywords):
            try:
                return open(*arguments, **keywords)
            finally:
                if next(opened) == moment:
                    write(cube, 2, 4)
                    mark_complete(cube, ledger_checksum(cube, layout))

        monkeypatch.setattr("wavefield.store.checked.open", open_and_go_on, raising=False)
        found = read(cube)
        assert found.done in (2, 4, 6)
        assert getattr(found, "damages", ()) == ()
        if next(opened) <= moment:
            break
        assert read(cube).done == 6
    assert moment >= 5
