"""Compiled loops where compiled code cannot be kept: a full home folder, one that may not be written."""

import errno

import numpy as np
from numba import float64
from numba.core import caching

from wavefield.compiled import compiled


def full(*args, **keywords):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_costs_the_time_of_compiling_and_nothing_else(monkeypatch):
    monkeypatch.setattr(caching.IndexDataCacheFile, "save", full)

    @compiled()
    def doubled(x):
        return 2 * x

    assert doubled(np.arange(3.0)).tolist() == [0, 2, 4]

    @compiled([float64(float64[::1])])
    def total(x):
        return x.sum()

    assert total(np.arange(3.0)) == 3
    assert len(total.signatures) == 1


def test_no_folder_for_compiled_code_is_none_of_the_users_business(monkeypatch):
    monkeypatch.setattr(caching.tempfile, "TemporaryFile", full)

    @compiled()
    def halved(x):
        return x / 2

    assert halved(np.arange(3.0)).tolist() == [0, 0.5, 1]
