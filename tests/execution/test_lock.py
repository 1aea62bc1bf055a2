"""One run at a time writes a store, whatever became of the one before."""

import os
import subprocess
import sys
import threading

import pytest

from wavefield.errors import StoreError
from wavefield.execution.run_files import locked

HOLDER = """
import os, sys, time
from pathlib import Path
from wavefield.execution.run_files import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    {then}
"""


def left(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def other(tmp_path):
    """Another process that holds the lock of a store, and then does something."""
    started = []

    def start(then):
        command = [sys.executable, "-c", HOLDER.format(then=then), str(tmp_path / "cube.zarr")]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_store_is_held_by_one_run_and_nothing_is_left(tmp_path):
    store = tmp_path / "cube.zarr"
    with locked(store):
        with pytest.raises(StoreError, match="another run is writing"), locked(store):
            pass
        assert left(tmp_path) == [".cube.zarr.lock"]
    assert left(tmp_path) == []


def test_a_run_of_another_process_is_respected_whatever_the_clock_does(tmp_path, other):
    other("time.sleep(60)")
    os.utime(tmp_path / ".cube.zarr.lock", (0, 0))
    with pytest.raises(StoreError, match="another run is writing"), locked(tmp_path / "cube.zarr"):
        pass


def test_the_lock_of_a_killed_run_is_free(tmp_path, other):
    other("os.kill(os.getpid(), 9)").wait()
    assert left(tmp_path) == [".cube.zarr.lock"]
    with locked(tmp_path / "cube.zarr"):
        pass
    assert left(tmp_path) == []


def test_of_many_that_come_at_once_one_gets_it(tmp_path):
    ready, done, got = threading.Barrier(8), threading.Barrier(8), []

    def come(number):
        ready.wait()
        try:
            with locked(tmp_path / "cube.zarr"):
                got.append(number)
                done.wait()
        except StoreError:
            done.wait()

    threads = [threading.Thread(target=come, args=[number]) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(got) == 1


@pytest.mark.parametrize("kind", ["text", "link"])
def test_a_file_of_the_user_under_that_name_stays(tmp_path, kind):
    path = tmp_path / ".cube.zarr.lock"
    (tmp_path / "mine").write_text("mine")
    path.symlink_to("mine") if kind == "link" else path.write_text("mine")
    with (
        pytest.raises(StoreError, match="is not a lock that wavefield wrote"),
        locked(tmp_path / "cube.zarr"),
    ):
        pass
    assert path.read_text() == "mine"
