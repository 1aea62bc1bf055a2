import numpy as np
import xarray as xr

import wavefield as wf
from wavefield.grid import Grid
from wavefield.matching.spectrum import Prior
from wavefield.measurement import GridGeometry, Settings
from wavefield.measurement.model import LearnedRecord, tabulated
from wavefield.tank import Scene
from wavefield.waves.gains import read_gain


def predicted_gain(scene, record):
    grid = Grid(scene.grid.x, scene.grid.y, scene.grid.step)
    table = tabulated(GridGeometry(scene.build_rig(), grid, Settings()), record)
    gains = {f"gain_{name}": (("direction", "k"), table[f"gain_{name}"]) for name in "zuvw"}
    return xr.Dataset(gains, {"direction": np.arange(8) * np.pi / 8, "k": table["k"]})


def test_the_gain_is_what_the_posterior_keeps_of_a_wave():
    k = tuple(np.linspace(0.04, 3.1, 40))
    # signal and noise are alike at half a radian per block
    flat = Prior.isotropic(k, [1e-6 * (0.5 / q) ** 5 for q in k], 1e6)
    scene = Scene.load("demo")
    record = LearnedRecord((), flat, tuple((name, flat) for name in ("cam1", "cam2", "cam3")))
    gain = predicted_gain(scene, record)
    assert read_gain(gain) is gain
    for name in ("gain_z", "gain_u", "gain_v", "gain_w"):
        np.testing.assert_allclose(gain[name][:, 0], 1, atol=0.01)
        assert float(gain[name][:, -1].max()) < 0.05
    geometry = GridGeometry(scene.build_rig(), Grid(scene.grid.x, scene.grid.y, scene.grid.step))
    half = gain.gain_z.sel(k=0.5 / geometry.lattice.step, method="nearest")
    np.testing.assert_allclose(half, 0.5, atol=0.08)  # the footprint of a block takes some
    # oblique cameras have pixels that are longer along x on the water
    short = gain.gain_w.sel(k=0.5 / geometry.lattice.step, method="nearest")
    assert float(short.sel(direction=0)) < float(short.sel(direction=np.pi / 2)) - 0.05


def test_a_cube_holds_its_gain(reference):
    cube = wf.open_cube(reference)
    stored = read_gain(cube)
    assert all(f"gain_{name}" in stored for name in "zuvw")
    assert float(stored.gain_z.isel(k=0).min()) > 0.9
