"""The small files of a cube beside their copies."""

import threading
import time

import pytest

import wavefield.store.metadata
from wavefield.errors import StoreError
from wavefield.store.metadata import check_metadata, keep_metadata, mark_complete


@pytest.fixture
def changed(tmp_path):
    """A cube whose metadata a run has changed, and whose copies it has not written yet."""
    (tmp_path / "checksum").mkdir()
    (tmp_path / "zarr.json").write_text("before")
    keep_metadata(tmp_path)
    (tmp_path / "zarr.json").write_text("after")
    return tmp_path


def test_readers_wait_for_a_run_that_is_about_to_write_the_copies(changed):
    timer = threading.Timer(0.15, keep_metadata, [changed])
    timer.start()
    check_metadata(changed)
    timer.join()


def test_what_does_not_become_equal_is_damage(changed, monkeypatch):
    monkeypatch.setattr(wavefield.store.metadata, "SETTLING_SECONDS", 0.15)
    with pytest.raises(StoreError, match=r"zarr\.json is not as it was written"):
        check_metadata(changed)


def test_nobody_writes_to_a_cube_whose_run_has_ended(changed):
    mark_complete(changed, 1)
    began = time.monotonic()
    with pytest.raises(StoreError, match=r"zarr\.json is not as it was written"):
        check_metadata(changed)
    assert time.monotonic() - began < 1.0
