"""What a record, its grid or its noise does not determine is refused, absent or marked."""

from dataclasses import replace

import numpy as np
from independent_seas import Sea

import wavefield as wf

SEA = Sea(highest=2.4, directions=((0.5, 8.0, 1.0),), noise=3e-4, shape=(600, 48, 60), height=0.02)


def test_waves_that_the_grid_does_not_resolve_have_no_direction():
    sea = replace(SEA, shape=(600, 24, 30), dx=0.07)  # holds waves to 2.6 Hz
    cube = sea.cube(("z", "z_t", "u", "v", "w")).assign_attrs(water_depth=np.inf)
    found = wf.analyze(cube)["direction"].to_dataset()
    there = np.isfinite(found.direction)
    assert 2.0 < float(found.frequency.where(there).max()) < 2.6
    assert bool((np.isfinite(found.direction_std) == there).all())
    assert bool((np.isfinite(found.D).all("theta") == there).all())
    error = (found.direction - 0.5) / found.direction_std
    assert float(abs(error.sel(frequency=[1.5, 2.0], method="nearest")).max()) < 3


def test_waves_below_the_noise_have_no_direction():
    found = wf.directions(SEA.cube(("w",)).w, [2.0, 4.0], current=(0.0, 0.0))
    assert np.isfinite(found.direction.values).tolist() == [True, False]
    assert np.isfinite(found.energy.values).all()


def test_coherent_noise_beyond_the_waves_is_marked():
    sea = Sea(highest=3.0, shape=(640, 40, 48), height=0.01)
    cube = sea.cube(("z", "z_t", "u", "v", "w"))
    noise = 1e-3 * np.random.default_rng(0).standard_normal(cube.w.shape, dtype="f4")
    cube["z_t"], cube["w"] = cube.z_t + noise, cube.w + noise
    found = wf.coherence(cube)
    beyond = found.k > 80
    assert float(found.gamma2.sel(term="w").where(beyond).mean()) > 0.9
    assert not bool(found.valid.where(beyond, False).any())
    assert bool(found.valid.sel(k=slice(14, 25)).all())


def test_a_short_record_states_neither_height_nor_noise():
    cube = Sea(lowest=1.0, highest=4.0, shape=(14, 32, 40), height=0.012).cube(("z", "z_t", "u", "v", "w"))
    waves = wf.analyze(cube)
    assert "significant_height" not in waves["statistics"]
    assert "or wave height: the record holds" in waves.attrs["notes"]
    assert np.isnan(waves["fusion"].sigma_dz)


def test_statistics_state_the_peak_frequency_where_the_record_holds_ten_periods():
    cube = Sea(lowest=1.2, highest=4.0, shape=(400, 32, 40), height=0.012, slope=6.0).cube(("z",))
    found, short = wf.statistics(cube), wf.statistics(cube.isel(time=slice(0, 100)))
    assert 1.15 < float(found.peak_frequency) < 1.6
    assert 0 < float(found.peak_frequency_std) < 0.3
    assert np.isnan(short.peak_frequency)
