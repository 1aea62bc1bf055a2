"""Worker processes leave nothing behind; a crash in compiled code is no lack of memory."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import wavefield.compiled
from wavefield.execution.pool import Pool

WORK = """
import multiprocessing
from wavefield.execution.pool import Pool

kept = []

def work(item):
    kept.append(multiprocessing.Lock())  # as Blosc does when it first compresses
    return item

if __name__ == "__main__":
    print(sorted(item for item, _ in Pool(2).map_unordered(work, [1, 2, 3])))
"""


def test_locks_that_libraries_make_in_workers_are_not_left_behind(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(WORK)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.stdout == "[1, 2, 3]\n"
    assert done.stderr == ""  # the tracker of resources counts what is left, at the very end


class Crashing:
    def __init__(self, folder, how=None):
        self.folder, self.how = folder, how

    def __call__(self, item):
        if self.how is not None:
            os.kill(os.getpid(), self.how)
        if (self.folder / "faulty.nbc").exists():  # as what reads faulty code, until it is removed
            os.kill(os.getpid(), signal.SIGSEGV)
        return item


@pytest.fixture
def cleared(tmp_path, monkeypatch):
    """Calls of the function that removes compiled code."""
    calls = []

    def clear():
        calls.append(1)
        Path(tmp_path / "faulty.nbc").unlink(missing_ok=True)
        return 1

    monkeypatch.setattr(wavefield.compiled, "clear_compiled", clear)
    return calls


def test_a_crash_in_compiled_code_removes_what_is_kept_of_it_once_and_the_work_goes_on(
    tmp_path, cleared, caplog
):
    (tmp_path / "faulty.nbc").touch()
    done = dict(Pool(2).map_unordered(Crashing(tmp_path), [1, 2, 3]))
    assert done == {1: 1, 2: 2, 3: 3}
    assert len(cleared) == 1
    assert "crashed in compiled code (SIGSEGV)" in caplog.text


def test_workers_that_crash_on_and_on_are_not_short_of_memory(tmp_path, cleared):
    ((_, error),) = Pool(1).map_unordered(Crashing(tmp_path, signal.SIGSEGV), [1])
    assert "crashed in compiled code (SIGSEGV)" in str(error)
    assert "memory ran out" not in str(error)
    assert len(cleared) == 1


def test_workers_that_the_system_ends_are_short_of_memory(tmp_path, cleared):
    ((_, error),) = Pool(1).map_unordered(Crashing(tmp_path, signal.SIGKILL), [1])
    assert "SIGKILL" in str(error)
    assert "memory ran out" in str(error)
    assert not cleared
