"""The ledger is read file by file, as Zarr would read it."""

import numpy as np
import pytest
import zarr

from wavefield.errors import StoreError
from wavefield.store.checked import checksum, chunk_path, stored_bytes
from wavefield.store.layout import StoreLayout, create_store
from wavefield.store.ledger import status
from wavefield.store.ledger_files import read_ledger
from wavefield.store.metadata import WATCHED
from wavefield.store.recipe import Recipe

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
