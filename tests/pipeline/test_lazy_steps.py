"""What is selected of a lazy cube along time is measured, and not the rest of its chunks."""

import pickle

import dask
import dask.array as da
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from wavefield.pipeline import lazy, lazy_steps
from wavefield.pipeline.chunk import Measured
from wavefield.pipeline.lazy_steps import LazySteps, StepsArray
from wavefield.variables import AROUND

SHAPE = 3, 4
VALUES = np.arange(40)[:, None, None] + np.zeros(SHAPE)


@pytest.fixture(scope="module")
def measured():
    """Ranges of steps that were measured; the values of a step are its number."""
    ranges = []

    def count(chunk, geometry, frame_rate, model):
        ranges.append((chunk.start, chunk.stop))
        steps = np.arange(chunk.start, chunk.stop)
        fields = {name: steps[:, None, None] + np.zeros(SHAPE, np.float32) for name in "zw"}
        return Measured(fields, steps.astype(np.uint8), {}, [])

    with pytest.MonkeyPatch.context() as patch, dask.config.set(scheduler="sync"):
        patch.setattr(lazy_steps, "measure_chunk", count)
        yield ranges


def arrays(chunk):
    """Elevation, vertical velocity and status of 40 steps, in chunks."""
    known = dask.delayed(lambda: (None, None), pure=False)()
    steps = LazySteps({}, None, 20.0, known, SHAPE, dask.base.tokenize(chunk))
    edges = [(i, min(i + chunk, 40)) for i in range(0, 40, chunk)]
    return [steps.array(name, edges) for name in ("z", "w", "frame_status")]


INDICES = st.one_of(
    st.integers(-40, 39),
    st.slices(40),
    st.lists(st.integers(-40, 39), min_size=1, max_size=6),
    st.lists(st.integers(0, 39), min_size=1, max_size=6).map(np.array),
)


@settings(max_examples=60, deadline=None)
@given(chunk=st.integers(1, 50), first=INDICES, rest=st.sampled_from([(), (slice(1, 3),), (..., 2), (0, 1)]))
def test_any_selection_has_its_values_from_its_own_steps_or_whole_chunks(measured, chunk, first, rest):
    z, _, status = arrays(chunk)
    measured.clear()
    np.testing.assert_array_equal(z[(first, *rest)], VALUES[(first, *rest)])
    done = {step for start, stop in measured for step in range(start, stop)}
    asked = set(np.atleast_1d(np.arange(40)[first]).tolist())
    assert asked <= done
    assert len(done) <= len(asked) + AROUND * len(asked) or not asked
    np.testing.assert_array_equal(status[first], VALUES[first][..., 0, 0])


def test_variables_of_a_step_are_measured_together_and_once(measured):
    z, w, _ = arrays(20)
    measured.clear()
    dask.compute(z[5], w[5], z[5:7][0])
    assert measured == [(5, 6)]


def test_selected_twice_means_the_steps_of_both(measured):
    z, *_ = arrays(20)
    measured.clear()
    part = z[2:17][3:5]
    assert isinstance(z[2:17], StepsArray)
    np.testing.assert_array_equal(part, VALUES[5:7])
    assert measured == [(5, 7)]


def test_the_arrays_go_with_those_of_dask_and_travel_as_whole_chunks(measured):
    z, *_ = arrays(20)
    cube = xr.Dataset({"z": (("time", "y", "x"), z), "c": (("time", "y", "x"), da.ones(z.shape))})
    total = xr.apply_ufunc(np.add, cube.z, cube.c, dask="parallelized", output_dtypes=[float])
    np.testing.assert_array_equal(total.isel(time=3), VALUES[3] + 1)
    assert cube.compute().z.shape == VALUES.shape
    np.testing.assert_array_equal(z.mean(axis=(1, 2)), np.arange(40))


def test_a_record_is_learned_once_for_all_that_is_computed(monkeypatch):
    calls = []
    monkeypatch.setattr(lazy._Learner, "_learn", lambda self, pairs: calls.append(1) or ("known", None))
    learner = lazy._Learner(None, 1.0, None)
    known = dask.delayed(learner, pure=False, traverse=False)([])
    assert dask.compute(known) == dask.compute(known) == (("known", None),)
    assert len(calls) == 1
    assert pickle.loads(pickle.dumps(learner))([]) == ("known", None)  # elsewhere it is learned anew
    assert len(calls) == 2
