"""How often lazy input is computed: never while a result is only described, once when it is asked for."""

from contextlib import contextmanager

import dask
import numpy as np
import pytest
import xarray as xr

from wavefield import waves

STEPS, NY, NX = 96, 20, 24


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


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A cube of noise, as a store."""
    rng = np.random.default_rng(3)
    fields = {
        name: (("time", "y", "x"), rng.standard_normal((STEPS, NY, NX)).astype("float32"))
        for name in ("z", "z_t", "u", "v", "w")
    }
    units = {name: {"units": "m" if name == "z" else "m s-1"} for name in fields}
    cube = xr.Dataset(
        {name: (*field, units[name]) for name, field in fields.items()},
        {
            "time": ("time", (np.arange(STEPS) + 0.5) / 20.0, {"units": "s"}),
            "y": ("y", 0.02 * np.arange(NY), {"units": "m"}),
            "x": ("x", 0.02 * np.arange(NX), {"units": "m"}),
        },
        {"frame_rate": 20.0, "water_depth": 0.7},
    )
    path = tmp_path_factory.mktemp("lazy") / "noise.zarr"
    cube.chunk(time=16).to_zarr(path, consolidated=False)
    return path


@pytest.fixture
def cube(stored):
    return xr.open_zarr(stored, consolidated=False)


@pytest.mark.parametrize("estimate", [waves.spectrum, waves.komega], ids=lambda f: f.__name__)
def test_spectra_read_the_cube_once_for_its_holes_and_once_for_the_result(cube, estimate):
    with assert_maximum_computes(1):
        record = waves.find_record(cube.w)
    with assert_maximum_computes(0):
        described = estimate(cube.w, record=record)
    with assert_maximum_computes(1):
        described.compute()
    with assert_maximum_computes(1):
        estimate(cube.w)
