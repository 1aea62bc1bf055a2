"""Files of probes as laboratories and buoys write them."""

import numpy as np
import pytest
import xarray as xr

from wavefield import waves as wv
from wavefield.errors import CubeError, ExperimentError
from wavefield.waves.probes.probe_files import Columns, probe_spectra


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("gap", [" ", "   ", "\t", ";", " ; "])
@pytest.mark.parametrize("named", [False, True])
def test_columns_may_be_parted_by_blanks(tmp_path, decimal, gap, named):
    rng = np.random.default_rng(len(gap))
    table = np.column_stack([np.arange(20) / 10, rng.normal(0, 5, (20, 2))])
    header = gap.join(("time", "p1 [mm]", "p2 [mm]"))
    rows = [gap.join(f"{value:9.4f}".replace(".", decimal) for value in row) for row in table]
    path = tmp_path / "gauges.txt"
    path.write_text("\n".join([] if named else [header]) + "\n".join(["", *rows]) + "\n")
    columns = Columns(1, {"p1": 2, "p2": 3}) if named else None
    probes = wv.read_probes(path, columns, unit="mm")
    assert np.allclose(probes.elevation.values, 1e-3 * table[:, 1:].T, atol=1e-7)


def waves(height, period, rate=10.0, duration=300.0, seed=0):
    """Elevation of irregular waves of a significant height (m) and a mean period (s)."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, duration, 1 / rate)
    omega = 2 * np.pi / period * rng.normal(1, 0.1, 60)
    z = np.cos(omega * time[:, None] + rng.uniform(0, 2 * np.pi, 60)).sum(axis=1)
    return time, z * height / 4 / z.std()


@pytest.mark.parametrize(("height", "period"), [(2.1, 5.0), (4.0, 7.0), (9.0, 11.0), (15.0, 15.0)])
def test_waves_of_the_open_sea_are_read(tmp_path, height, period):
    path = tmp_path / "buoy.csv"
    np.savetxt(path, np.column_stack(waves(height, period)), delimiter=",", header="time,heave", comments="")
    assert 4 * float(wv.read_probes(path).elevation.std()) == pytest.approx(height, rel=1e-6)


@pytest.mark.parametrize(("height", "period"), [(4.0, 0.5), (30.0, 1.0), (100.0, 2.0), (400.0, 3.0)])
def test_waves_of_a_tank_in_millimetres_are_not_taken_for_metres(tmp_path, height, period):
    path = tmp_path / "gauge.csv"
    np.savetxt(path, np.column_stack(waves(height, period)), delimiter=",", header="time,p1", comments="")
    with pytest.raises(ExperimentError, match="varies by"):
        wv.read_probes(path)


def spectra(time, z, span=None):
    names = [f"p{k}" for k in range(len(z))]
    coords = {"time": time, "probe": names} | {f"probe_{a}": ("probe", np.zeros(len(z))) for a in "xy"}
    omega = xr.DataArray(2 * np.pi * np.arange(90) / 20.0, dims="omega")
    return probe_spectra(xr.Dataset({"elevation": (("probe", "time"), z)}, coords), omega, span or (0, 299))


@pytest.mark.parametrize("seed", range(3))
def test_of_a_record_with_gaps_the_longest_whole_part_is_used(seed):
    rng = np.random.default_rng(seed)
    time, z = waves(2.0, 5.0, seed=seed)
    first = int(rng.integers(200, 500))
    expected = spectra(time[first + 30 :], z[None, first + 30 :], (time[first + 30], 299.9)).Ez_probes
    holed = z.copy()
    holed[first : first + 30] = np.nan
    with pytest.warns(UserWarning, match="longest part"):
        found = spectra(time, holed[None], (0, 299.9)).Ez_probes
    assert np.allclose(found, expected, equal_nan=True, rtol=1e-6)
    kept = np.delete(np.arange(len(time)), np.arange(first, first + 30))  # a logger that paused
    for clock in (0.0, 0.037):  # and went on at times of its own
        later = time[kept] + clock * (kept > first)
        with pytest.warns(UserWarning, match="longest part"):
            paused = spectra(later, z[None, kept], (0, 299.99)).Ez_probes
        assert np.allclose(paused, expected, equal_nan=True, rtol=2e-3)


def test_without_a_whole_segment_probes_are_refused():
    time, z = waves(2.0, 5.0)
    z[::100] = z[1::100] = z[2::100] = z[3::100] = np.nan
    with pytest.raises(CubeError, match="none is whole for one segment"):
        spectra(time, z[None])
