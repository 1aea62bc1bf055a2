import dask
import numpy as np
import pytest
import xarray as xr
from waves_cases import PeriodicSea, linear_cube, random_waves

import wavefield as wf
import wavefield.waves as wv
from wavefield.errors import CubeError, StoreError
from wavefield.series.probes import read_probes
from wavefield.variables import GROUPS, find, rows_of
from wavefield.waves.probes import probe_spectra
from wavefield.waves.record import find_record


@pytest.fixture(scope="module")
def sea():
    cube = linear_cube(random_waves(n=150), 400, 40, 50, dx=0.02, noise_z=0.0003, noise_dz=0.0002)
    return cube


@pytest.fixture(scope="module")
def probes(tmp_path_factory):
    """Two probes at 100 Hz in the same sea."""
    path = tmp_path_factory.mktemp("probes") / "probes.csv"
    waves = random_waves(n=150)
    t = np.arange(-100, 2200) * 0.01
    z = [waves.on_grid(t, [y], [x], "z")["z"].ravel() for x, y in ((0.2, 0.3), (0.9, 0.5))]
    lines = ["time,p1,p2", *(f"{a:.4f},{b:.6f},{c:.6f}" for a, b, c in zip(t, *z))]
    path.write_text("\n".join(lines))
    return read_probes(path, places={"p1": (0.2, 0.3), "p2": (0.9, 0.5)})


@pytest.fixture(scope="module")
def store(sea, probes, tmp_path_factory):
    path = tmp_path_factory.mktemp("waves") / "waves.zarr"
    calls = []
    wf.analyze(sea, path, probes=probes, progress=lambda *at: calls.append(at))
    assert calls
    assert calls[-1][0] == calls[-1][1]
    return xr.open_datatree(path, engine="zarr")


def test_the_store_holds_the_variables_of_the_table(store):
    # with a gain only: see test_fusion
    left_out = {"Ez_komega", "valid_k"}
    for group in GROUPS:
        dataset = store[group].to_dataset()
        rows = {row.name: row for row in rows_of(group)}
        assert set(rows) - left_out <= set(dataset.variables), group
        for name, row in rows.items():
            if name in dataset:
                assert dataset[name].dims == row.dims, f"{group}: {name}"
                assert dataset[name].attrs.get("long_name") == row.long_name, f"{group}: {name}"
        for name in dataset.variables:
            assert find(str(name), group) or name in ("probe", "error"), f"{group}: {name}"


def test_every_variable_states_its_unit_and_meaning(store):
    for group in store.children.values():
        for name, variable in group.to_dataset().data_vars.items():
            assert variable.attrs.get("units"), f"{group.name}: {name}"
            assert variable.attrs.get("long_name"), f"{group.name}: {name}"


def test_its_spectra_are_those_of_the_functions(sea, store):
    segment = store.attrs["segment"]
    single = wv.komega(sea.w, segment=segment).E
    np.testing.assert_allclose(store["spectra"].E.sel(quantity="w"), single, rtol=1e-6)
    C = wv.coherence(sea, segment=segment)
    np.testing.assert_allclose(store["coherence"].C, C.C, rtol=1e-9)
    full = wv.spectrum(sea.w, segment=segment).E
    lines = store["spectra"].omega_map.values
    maps = store["spectra"].E_kxky.sel(quantity_map="w")
    np.testing.assert_allclose(maps, full.sel(omega=lines, method="nearest"), rtol=1e-5)


def test_the_probes_agree_with_the_cube(store):
    spectra = store["spectra"].to_dataset()
    stereo, fusion = (spectra.sel(source=source, drop=True) for source in ("stereo", "fusion"))
    band = stereo.valid_Ez & spectra.valid_probes & (spectra.frequency > 1) & (spectra.frequency < 3.5)
    ratio = np.log((spectra.Ez_probes / fusion.Ez).where(band))
    assert abs(float(ratio.mean())) < 0.35  # two points of a sea, 20 s
    total = [float(energy.where(band).sum()) for energy in (spectra.Ez_probes, stereo.Ez)]
    assert total[0] == pytest.approx(total[1], rel=0.5)
    assert list(spectra.probe.values) == ["p1", "p2"]
    assert float(spectra.probe_x[1]) == 0.9


def test_neither_chunks_nor_workers_matter_where_segments_are_summed_in_several_chains(sea):
    long = sea.isel(y=slice(0, 20), x=slice(0, 24))
    expected = wf.analyze(long, segment=32)
    assert expected.attrs["segments"] > 2 * 8
    with dask.config.set(scheduler="synchronous"):
        other = wf.analyze(long.chunk({"time": 37, "x": 11}), segment=32)
    for name, group in expected.children.items():
        for variable in group.data_vars:
            np.testing.assert_array_equal(other[name][variable], group[variable], err_msg=variable)


def test_a_cube_in_a_store_is_read_piece_by_piece(sea, tmp_path):
    path = tmp_path / "cube.zarr"
    part = sea.isel(time=slice(0, 140), y=slice(0, 20), x=slice(0, 24))
    part.chunk({"time": 50}).to_zarr(path, consolidated=False)
    out = wf.analyze(path, tmp_path / "waves.zarr", segment=64)
    expected = wf.analyze(part, tmp_path / "waves.zarr", segment=64)  # replaces the first
    np.testing.assert_array_equal(out["spectra"].E, expected["spectra"].E)
    assert not list(tmp_path.glob(".*partial"))


@pytest.mark.parametrize("steps", [8, 41, 90])
def test_a_short_record_is_analysed_and_states_how_little_it_shows(steps):
    short = linear_cube(random_waves(n=60), steps, 30, 40, dx=0.02)
    out = wf.analyze(short)
    assert "degrees of freedom" in out.attrs["notes"]
    assert out.attrs["degrees_of_freedom"] >= 2
    E = out["spectra"].E_omega.sel(quantity="w")
    assert float(E.sum()) > 0
    if steps <= 41:  # at most 2 s: what it is too short for is not stated
        assert "No spectral peak, steepness" in out.attrs["notes"]
        assert not {"peak_frequency", "peak_k", "steepness"} & set(out["statistics"].data_vars)


def test_gaps_edges_and_unknown_depth_are_reported(sea):
    spoiled = sea.copy(deep=True)
    spoiled["z"][100:102] = np.nan
    spoiled["w"][:, :3] = np.nan
    spoiled["u"][300:320] = np.nan
    del spoiled.attrs["water_depth"]
    out = wf.analyze(spoiled, segment=64)
    notes = out.attrs["notes"]
    assert "2 missing steps in short gaps were bridged" in notes
    assert "Of 40 x 50 nodes (y, x) the largest full rectangle was used, 37 x 50" in notes
    assert "deep water was assumed" in notes
    assert out.attrs["runs"] == 2
    assert out.attrs["water_depth"] == "deep"
    assert np.isfinite(out["spectra"].E).all()


def test_still_water_does_not_break_it():
    still = linear_cube(random_waves(n=5), 64, 20, 24, dx=0.02) * 0
    out = wf.analyze(still)
    assert "The dispersion relation was not fitted" in out.attrs["notes"]


def test_what_cannot_be_analysed_is_reported_in_one_sentence(sea, probes, tmp_path):
    with pytest.raises(CubeError, match="no 'z_t'"):
        wf.analyze(sea.drop_vars("z_t"))
    with pytest.raises(CubeError, match="less than one segment of 512"):
        wf.analyze(sea, segment=512)
    with pytest.raises(StoreError, match="cannot be read as a cube"):
        wf.analyze(tmp_path / "nothing.zarr")
    late = sea.assign_coords(time=sea.time + 1000.0)
    with pytest.raises(CubeError, match="share less than one segment"):
        wf.analyze(late, probes=probes)
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(StoreError, match="cannot be written"):
        wf.analyze(sea.isel(time=slice(0, 40)), blocked / "waves.zarr")


def test_probes_at_their_own_rate_hold_the_variance():
    rng = np.random.default_rng(3)
    t = np.arange(0, 200, 1 / 75)
    values = 0.01 * rng.standard_normal((2, t.size))
    data = xr.Dataset(
        {"elevation": (("probe", "time"), values)},
        {"time": t, "probe": ["a", "b"], "probe_x": ("probe", [0.0, 1.0]), "probe_y": ("probe", [0.0, 1.0])},
    )
    omega = 2 * np.pi * np.arange(129) / (256 * 0.05)
    out = probe_spectra(data, xr.DataArray(omega, {"omega": omega}, ("omega",)), (0.0, 200.0))
    level = 1e-4 / (np.pi * 75)
    inside = out.isel(omega=slice(3, -1))
    assert float(inside.Ez_probes.mean()) == pytest.approx(level, rel=0.03)
    held = (inside.Ez_probes * inside.low_probes < level) & (inside.Ez_probes * inside.high_probes > level)
    assert 0.88 < float(held.mean()) <= 1


def test_memory_stays_bounded_by_the_segment(tmp_path):
    """The array memory of a pass does not grow with the record, and what was read is not kept."""
    import tracemalloc

    peaks = []
    for steps in (256, 1024):
        cube = PeriodicSea(n=64).cube(steps, 40, 48).drop_vars("exact")
        path = tmp_path / f"{steps}.zarr"
        cube.chunk({"time": 32}).to_zarr(path, consolidated=False)
        stored = xr.open_zarr(path, consolidated=False, chunks={})
        with dask.config.set(scheduler="synchronous"):
            wv.komega(stored.w, segment=64)
            tracemalloc.start()
            record = find_record(stored)
            wv.komega(stored.w, segment=64, record=record).compute()
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]


def test_a_bad_cell_costs_neither_its_probe_nor_the_others(sea, probes, tmp_path):
    read = probes.load().copy(deep=True)
    omega = wv.E_omega(wv.komega(sea.z, segment=64)).omega
    span = (float(sea.time[0]), float(sea.time[-1]))
    whole = probe_spectra(read, omega, span)
    read.elevation[0, 400:402] = np.nan
    corrected = probe_spectra(read, omega, span)
    assert float(abs(corrected.Ez_probe - whole.Ez_probe).sum() / whole.Ez_probe.sum()) < 0.01
    read.elevation[0, 400:420] = np.nan
    with pytest.warns(UserWarning, match=r"is left out: 20 of its \d+ values"):
        left = probe_spectra(read, omega, span)
    assert np.isnan(left.Ez_probe[0]).all()
    assert np.isfinite(left.Ez_probe[1:]).any()
    with pytest.raises(CubeError, match="every probe lacks more than 3 values in a row"):
        probe_spectra(read.isel(probe=[0]), omega, span)
    paused = read.isel(time=np.r_[0:500, 520 : read.sizes["time"]])
    with pytest.raises(CubeError, match="time steps are unequal"):
        probe_spectra(paused, omega, span)
