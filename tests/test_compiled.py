"""Compiled code is kept on disk, also where that fails or many processes begin; libraries have one thread."""

import errno
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import threadpoolctl
from numba import float64
from numba.core import caching

from wavefield.compiled import compiled
from wavefield.one_thread import one_thread


def full(*args, **keywords):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(("where", "name"), [(Path, "write_bytes"), (caching.tempfile, "TemporaryFile")])
def test_a_full_disk_or_no_folder_costs_the_time_of_compiling_and_nothing_else(monkeypatch, where, name):
    monkeypatch.setattr(where, name, full)

    @compiled()
    def doubled(x):
        return 2 * x

    assert doubled(np.arange(3.0)).tolist() == [0, 2, 4]

    @compiled([float64(float64[::1])])
    def total(x):
        return x.sum()

    assert total(np.arange(3.0)) == 3
    assert len(total.signatures) == 1


LOOP = """
from wavefield.compiled import compiled

@compiled()
def total(x):
    out = 0.0
    for i in range(x.shape[0]):
        out += {factor} * x[i]
    return out
"""
PROCESS = """
import sys
import numpy as np
import loop
x = np.arange(8.0)
for kind in sys.argv[1]:
    print(loop.total({"c": x[:4], "s": x[::2], "f": x[:4].astype("f4"), "i": x[:4].astype(int)}[kind]))
"""


@pytest.fixture
def folder(tmp_path):
    """A module with one compiled loop, and a place for its compiled code."""
    (tmp_path / "loop.py").write_text(LOOP.format(factor=1))
    (tmp_path / "process.py").write_text(PROCESS)
    return tmp_path


def started(folder, kinds):
    """A process that calls the loop with arrays of several kinds: contiguous, strided, float32, integer."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "kept")}
    command = [sys.executable, folder / "process.py", kinds]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def answers(process):
    out, problem = process.communicate(timeout=120)
    assert process.returncode == 0, problem
    return out.split()


def kept(folder):
    return sorted((folder / "kept").rglob("*.nbc"))


EXPECTED = {"c": "6.0", "s": "12.0", "f": "6.0", "i": "6.0"}


@pytest.mark.slow
def test_first_processes_at_once_keep_the_code_of_each_kind_apart(folder):
    orders = ("csfi", "ifsc")
    for process, kinds in [(started(folder, kinds), kinds) for kinds in orders]:
        assert answers(process) == [EXPECTED[kind] for kind in kinds]
    before = {path: path.stat().st_mtime_ns for path in kept(folder)}
    assert len(before) == len(EXPECTED)
    assert answers(started(folder, "sfic")) == [EXPECTED[kind] for kind in "sfic"]
    assert {path: path.stat().st_mtime_ns for path in kept(folder)} == before  # read, not compiled again


def test_kept_code_is_of_the_sources_as_they_are_now(folder):
    assert answers(started(folder, "c")) == ["6.0"]
    (folder / "loop.py").write_text(LOOP.format(factor=2))
    assert answers(started(folder, "c")) == ["12.0"]
    assert len(kept(folder)) == 1  # that of the sources of before is gone


@pytest.mark.slow
@pytest.mark.parametrize(
    "damaged",
    [lambda whole: b"", lambda whole: whole[:-100], lambda whole: whole[:2000] + b"\0" + whole[2001:]],
    ids=["empty", "cut off", "changed"],
)
def test_damaged_code_is_compiled_again(folder, damaged):
    assert answers(started(folder, "c")) == ["6.0"]
    (path,) = kept(folder)
    whole = path.read_bytes()
    path.write_bytes(damaged(whole))
    assert answers(started(folder, "c")) == ["6.0"]
    assert path.read_bytes()[-100:] == whole[-100:]


def blas_threads():
    return {pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"}


def test_threads_of_a_pool_limit_what_the_main_thread_has_set():
    with threadpoolctl.threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()

        def inside(_):
            with one_thread():
                return blas_threads()

        with ThreadPoolExecutor(2) as pool:
            assert all(found <= {1} for found in pool.map(inside, range(8)))
        assert blas_threads() == before
