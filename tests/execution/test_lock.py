"""One run at a time writes a store, whatever became of the one before."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest

from wavefield.errors import StoreError
from wavefield.execution.lock import Lock

NOBODY = 65534
KILLED = """
import os, sys
from pathlib import Path
from wavefield.execution.lock import Lock
with Lock.hold(Path(sys.argv[1])):
    os.kill(os.getpid(), 9)
"""


def left(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_second_run_is_refused_with_the_name_of_who_holds_the_store(tmp_path):
    store = tmp_path / "cube.zarr"
    with Lock.hold(store):
        with (
            pytest.raises(StoreError, match=f"is writing .*process {os.getpid()} of"),
            Lock.hold(store),
        ):
            pass
        assert left(tmp_path) == [".cube.zarr.lock"]
    assert left(tmp_path) == []


@pytest.fixture
def two_users():
    """A folder of one user, and the other whom we are from now on."""
    folder = Path(tempfile.mkdtemp(dir="/tmp"))  # pytest's own cannot be entered by others
    if os.geteuid():
        pytest.skip("only root can be two users")
    try:
        yield folder
    finally:
        os.seteuid(0)
        shutil.rmtree(folder)


def test_of_two_users_in_one_folder_the_second_reads_who_is_there_and_what_may_not_be(two_users):
    store = two_users / "cube.zarr"
    with Lock.hold(store):
        pass  # what is imported late is imported
    two_users.chmod(0o755)
    os.seteuid(NOBODY)
    with pytest.raises(StoreError, match=r"cube.zarr cannot be written: Permission denied; .*permissions"):
        Lock.hold(store).__enter__()
    os.seteuid(0)
    two_users.chmod(0o1777)
    with Lock.hold(store):
        os.seteuid(NOBODY)
        with pytest.raises(StoreError, match=f"another run is writing .*process {os.getpid()} of"):
            Lock.hold(store).__enter__()
        os.seteuid(0)
    os.seteuid(NOBODY)
    with Lock.hold(store):  # the other has gone
        assert store.with_name(".cube.zarr.lock").stat().st_uid == NOBODY


def test_the_lock_of_a_killed_run_is_taken_over(tmp_path):
    store = tmp_path / "cube.zarr"
    subprocess.run([sys.executable, "-c", KILLED, str(store)])
    assert left(tmp_path) == [".cube.zarr.lock"]
    with Lock.hold(store) as lock:
        lock.check()
    assert left(tmp_path) == []


def held_elsewhere(store, seconds_ago):
    path = store.with_name(f".{store.name}.lock")
    path.write_text(json.dumps({"token": "t", "machine": "another", "host": "node7", "pid": 1, "since": 0}))
    then = time.time() - seconds_ago
    os.utime(path, (then, then))


def test_a_run_on_another_machine_holds_the_store_as_long_as_it_gives_signs_of_life(tmp_path):
    store = tmp_path / "cube.zarr"
    held_elsewhere(store, 20)
    with pytest.raises(StoreError, match="process 1 of node7"), Lock.hold(store):
        pass
    held_elsewhere(store, 600)
    with Lock.hold(store):
        pass
    assert left(tmp_path) == []


def test_of_many_that_find_a_dead_lock_only_one_gets_it(tmp_path):
    store = tmp_path / "cube.zarr"
    held_elsewhere(store, 600)
    start, refused, inside = threading.Barrier(8), [], []

    def attempt():
        start.wait()
        try:
            with Lock.hold(store):
                inside.append(1)
                done.wait(60)  # until the others have been refused
        except StoreError as error:
            refused.append(str(error))
            if len(refused) == 7:
                done.set()

    done = threading.Event()
    threads = [threading.Thread(target=attempt) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(inside) == 1
    assert len(refused) == 7


def test_a_run_that_was_taken_for_dead_stops_and_leaves_the_other_its_lock(tmp_path, monkeypatch):
    monkeypatch.setattr("wavefield.execution.lock._TOUCH", 0.01)
    store = tmp_path / "cube.zarr"
    with Lock.hold(store) as lock:
        lock.path.unlink()
        held_elsewhere(store, 0)
        while not lock._lost:
            time.sleep(0.01)
        with pytest.raises(StoreError, match="another run took over"):
            lock.check()
    assert left(tmp_path) == [".cube.zarr.lock"]
