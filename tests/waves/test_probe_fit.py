"""A probe beside the elevation: what is wrong with its unit, sign or clock is found."""

import numpy as np
import pytest
import xarray as xr
from waves_cases import linear_cube, random_waves

from wavefield.waves.probes import fit_probes

PLACE = (0.26, 0.30)  # a node


@pytest.fixture(scope="module")
def z():
    return linear_cube(random_waves(n=40), 240, 30, 40, dx=0.02).z


def probe(z, place=PLACE, *, factor=1.0, clock=0.0, noise=1e-4, stated=PLACE):
    """A gauge at 100 Hz at a place of the field."""
    here = z.sel(x=place[0], y=place[1], method="nearest")
    time = np.arange(float(z.time[0]), float(z.time[-1]), 0.01)
    shown = factor * np.interp(time, z.time, here)
    shown += noise * (abs(factor) or 1.0) * np.random.default_rng(1).standard_normal(time.size)
    places = {"probe_x": ("probe", [stated[0]]), "probe_y": ("probe", [stated[1]])}
    return xr.Dataset(
        {"elevation": (("probe", "time"), shown[None])},
        {"time": time + clock, "probe": ["p1"], **places},
    )


def problems(z, probes):
    (fit,) = fit_probes(z, probes)
    return [found for found, _ in fit.problems(0.05)], fit


def test_a_probe_that_fits_raises_no_remark(z):
    kinds, fit = problems(z, probe(z))
    assert kinds == []
    assert fit.at_zero_lag > 0.97
    assert abs(fit.lag) < 0.005
    assert fit.gain == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"factor": -1.0}, ["falls where"]),
        ({"factor": -1000.0}, ["falls where", "times the elevation"]),
        ({"clock": 2.15}, ["its clock is"]),
        ({"factor": 0.6}, ["times the elevation"]),
        ({"place": (0.66, 0.10)}, ["unlike the elevation"]),
    ],
)
def test_what_does_not_fit_is_named(z, how, words):
    found, fit = problems(z, probe(z, **how))
    assert len(found) == len(words)
    assert all(word in one for word, one in zip(words, found, strict=True))
    if "clock" in how:
        assert fit.lag == pytest.approx(how["clock"], abs=0.01)


def test_noise_is_unlike_and_what_lies_outside_is_not_judged(z):
    kinds, _ = problems(z, probe(z, factor=0.0, noise=0.01))
    assert ["unlike the elevation" in one for one in kinds] == [True]
    assert fit_probes(z, probe(z, stated=(9.0, 9.0))) == []
    assert fit_probes(z.isel(time=slice(0, 20)), probe(z)) == []
