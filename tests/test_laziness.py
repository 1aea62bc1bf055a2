"""How often a lazy cube is read by an estimate of its waves."""

from contextlib import contextmanager

import dask
import pytest

from wavefield import waves
from wavefield.pipeline import open_cube
from wavefield.waves.record import find_record


@contextmanager
def assert_maximum_computes(most: int):
    """Fail if dask is asked for results more often than this."""
    count = 0

    def counting(graph, keys, **options):
        nonlocal count
        count += 1
        assert count <= most, f"computed {count} times, at most {most} allowed"
        return dask.get(graph, keys)

    with dask.config.set(scheduler=counting):
        yield


@pytest.fixture
def cube(reference):
    return open_cube(reference)


@pytest.mark.parametrize("estimate", [waves.spectrum, waves.komega], ids=lambda f: f.__name__)
def test_spectra_read_the_cube_once_for_its_holes_and_once_for_the_result(cube, estimate):
    with assert_maximum_computes(1):
        record = find_record(cube.w)
    with assert_maximum_computes(1):
        estimate(cube.w, record=record, segment=8)
    with assert_maximum_computes(2):
        estimate(cube.w, segment=8)
