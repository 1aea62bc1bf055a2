"""A probe beside the elevation: what is wrong with its unit, sign, clock or place is found by itself."""

import numpy as np
import pytest
import xarray as xr
from waves_cases import linear_cube, random_waves

from wavefield.errors import ExperimentError
from wavefield.waves import read_probes
from wavefield.waves.probes.probe_files import Columns
from wavefield.waves.probes.probe_fit import fit_probes

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
    return [kind for kind, _, _ in fit.problems(0.05)], fit


def test_a_probe_that_fits_raises_no_remark(z):
    kinds, fit = problems(z, probe(z))
    assert kinds == []
    assert fit.peak_correlation > 0.97
    assert abs(fit.lag) < 0.005
    assert fit.gain == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("how", "kinds"),
    [
        ({"factor": 1000.0}, ["unit"]),
        ({"factor": 100.0}, ["unit"]),
        ({"factor": -1.0}, ["sign"]),
        ({"factor": -1000.0}, ["sign", "unit"]),
        ({"clock": 2.15}, ["clock"]),
        ({"clock": -0.4}, ["clock"]),
        ({"factor": 0.6}, ["gain"]),
        ({"place": (0.66, 0.10)}, ["position"]),
    ],
)
def test_what_does_not_fit_is_named(z, how, kinds):
    found, fit = problems(z, probe(z, **how))
    assert found == kinds
    if "clock" in how:
        assert fit.lag == pytest.approx(how["clock"], abs=0.01)
    if "place" in how:
        assert fit.place == pytest.approx(how["place"], abs=0.03)


def test_noise_is_unlike_and_what_lies_outside_is_not_judged(z):
    kinds, _ = problems(z, probe(z, factor=0.0, noise=0.01))
    assert kinds == ["unlike"]
    assert fit_probes(z, probe(z, stated=(9.0, 9.0))) == []
    assert fit_probes(z.isel(time=slice(0, 20)), probe(z)) == []


LABVIEW = """\
Messung 7\tKanal 1-3
Datum\t22.11.2026
Zeit [s]\tWG 1 [mm]\tTemp\tWG 2 [mm]
0,00\t1,5\t20,1\t-2,5
0,01\t1,25\t20,1\t-2,0
"""


@pytest.mark.parametrize(
    ("text", "columns", "values"),
    [
        (LABVIEW, Columns("Zeit", {"p1": "WG 1", "p2": "WG 2"}), [[1.5e-3, 1.25e-3], [-2.5e-3, -2e-3]]),
        (LABVIEW, Columns("Zeit [s]", {"p2": 4}), [[-2.5e-3, -2e-3]]),
        ("0 ; 1,5 ; 7\n0,01 ; 1,25 ; 8\n", Columns(1, {"p1": 2}), [[1.5, 1.25]]),
        ("run 9\n0,1.5,7\n0.01,1.25,8\n", Columns(1, {"a": 3, "b": 2}), [[7, 8], [1.5, 1.25]]),
    ],
)
def test_a_laboratorys_columns_are_mapped(tmp_path, text, columns, values):
    path = tmp_path / "probes.txt"
    path.write_text(text)
    unit = "" if "mm" in text else "m"
    read = read_probes(path, columns, unit=unit, factor=-1.0, clock=3.0, places={"p1": (1.0, 2.0)})
    np.testing.assert_allclose(read.elevation, -np.array(values))
    np.testing.assert_allclose(read.time, [3.0, 3.01])
    assert list(read.probe.values) == list(columns.probes)
    if "p1" in columns.probes:
        assert (float(read.probe_x[0]), float(read.probe_y[0])) == (1.0, 2.0)


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        (Columns("Zeit", {"p1": "WG 9"}), "no header has the columns Zeit, WG 9; there is Zeit"),
        (Columns(1, {"p1": 9}), "no line has numbers in the columns 1, 9"),
    ],
)
def test_columns_that_are_not_there_are_named(tmp_path, columns, expected):
    path = tmp_path / "probes.txt"
    path.write_text(LABVIEW)
    with pytest.raises(ExperimentError, match=expected):
        read_probes(path, columns)


def test_a_bad_number_is_named_with_its_own_line(tmp_path):
    path = tmp_path / "probes.txt"
    path.write_text(LABVIEW + "0,02\tx\t20,1\t-1,0\n")
    with pytest.raises(ExperimentError, match=r"probes.txt, line 6: 'x' is no number"):
        read_probes(path, Columns("Zeit", {"p1": "WG 1"}))
