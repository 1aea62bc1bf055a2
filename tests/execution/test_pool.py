"""Worker processes leave nothing behind; a crash in compiled code is no lack of memory."""

import logging
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import wavefield.compiled
import wavefield.execution.pool
from wavefield.errors import StoreError
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


IMPORTED = """
import sys
from wavefield.execution.pool import Pool

def imported(name):
    return name in sys.modules

if __name__ == "__main__":
    print(dict(Pool(1).map_unordered(imported, ["wavefield.measurement.measure"])))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux only")
def test_workers_share_the_imports_of_the_process_that_they_are_forked_from(tmp_path):
    script = tmp_path / "script.py"  # a process of its own: this one may have a fork server already
    script.write_text(IMPORTED)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.stdout == "{'wavefield.measurement.measure': True}\n", done.stderr


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


def test_workers_that_the_system_ends_are_short_of_memory(tmp_path, cleared, caplog):
    ((_, error),) = Pool(1).map_unordered(Crashing(tmp_path, signal.SIGKILL), [1])
    assert "SIGKILL" in str(error)
    assert "memory ran out" in str(error)
    assert caplog.text.count("was ended by SIGKILL; another takes its place") == 3
    assert not cleared


class Suspended:
    """Suspends its own process, the first time or always; the marks count the times."""

    def __init__(self, folder, always=False):
        self.folder, self.always = folder, always

    def __call__(self, item):
        if self.always or not list(self.folder.iterdir()):
            (self.folder / str(os.getpid())).touch()
            os.kill(os.getpid(), signal.SIGSTOP)
        return item


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(wavefield.execution.pool, "CHECK_S", 0.05)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_worker_that_is_suspended_is_reported_and_another_does_its_work(
    tmp_path, caplog, impatient, workers
):
    done = dict(Pool(workers).map_unordered(Suspended(tmp_path), [1, 2, 3]))
    assert done == {1: 1, 2: 2, 3: 3}
    (suspended,) = tmp_path.iterdir()
    assert f"a worker (process {suspended.name}) was suspended by a signal" in caplog.text


def test_work_over_which_all_workers_are_suspended_is_given_up(tmp_path, impatient):
    ((_, error),) = Pool(1).map_unordered(Suspended(tmp_path, always=True), [1])
    assert "was suspended by a signal" in str(error)
    assert "3 times" in str(error)


def continued(item):
    """Suspended for a moment, as by a scheduler of jobs."""
    command = f"import os, signal, time; time.sleep(0.3); os.kill({os.getpid()}, signal.SIGCONT)"
    subprocess.Popen([sys.executable, "-c", command])
    os.kill(os.getpid(), signal.SIGSTOP)
    return os.getpid()


def test_a_worker_that_goes_on_by_itself_is_left_in_peace(caplog, monkeypatch):
    monkeypatch.setattr(wavefield.execution.pool, "CHECK_S", 0.2)
    ((_, result),) = Pool(1).map_unordered(continued, [1])
    assert isinstance(result, int)
    assert not caplog.records


def greedy(item):
    np.empty(1 << 60, np.uint8)


def test_an_allocation_that_fails_is_one_sentence_with_the_memory_that_is_needed():
    ((_, error),) = Pool(1).map_unordered(greedy, [1])
    assert isinstance(error, StoreError)
    assert re.search(r"memory ran out: the work needs at least [\d.]+ GB per worker", str(error))
    assert "fewer `workers`" in str(error)
    assert "\n" not in str(error)


def test_workers_that_the_system_ends_for_memory_are_distinguished_from_others(tmp_path, monkeypatch):
    counts = iter([4, 5, 5, 5])
    monkeypatch.setattr(wavefield.execution.pool, "kills_for_memory", lambda: next(counts))
    ((_, error),) = Pool(1).map_unordered(Crashing(tmp_path, signal.SIGKILL), [1])
    assert "memory ran out: the system ended 3 workers" in str(error)
    assert "GB per worker" in str(error)


def warn(item):
    logging.getLogger("wavefield.run").warning("of item %s", item)
    return item


def test_warnings_of_workers_reach_the_log_of_the_run(caplog):
    assert dict(Pool(2).map_unordered(warn, [1, 2])) == {1: 1, 2: 2}
    assert sorted(record.message for record in caplog.records) == ["of item 1", "of item 2"]
