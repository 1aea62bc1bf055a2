import json

import numpy as np
import pytest
import xarray as xr

import wavefield.waves as wv
from wavefield import matching
from wavefield.cubes import predicted_gain
from wavefield.errors import CubeError
from wavefield.measurement import Settings
from wavefield.measurement.gain import matched
from wavefield.tank import Scene

BLOCK = 5


def photograph(x, y, size):
    """Beads as Gaussian spots of 0.8 px, on a square image."""
    image = np.zeros((size + 8, size + 8))
    near = np.arange(-3, 4)
    column, row = np.rint(x).astype(int), np.rint(y).astype(int)
    inside = (column >= 0) & (column < size) & (row >= 0) & (row < size)
    column, row, x, y = column[inside], row[inside], x[inside], y[inside]
    for j in near:
        for i in near:
            far = (column + i - x) ** 2 + (row + j - y) ** 2
            np.add.at(image, (row + j + 4, column + i + 4), 100 * np.exp(-far / (2 * 0.8**2)))
    return image[4:-4, 4:-4].astype(np.float32)


@pytest.mark.parametrize("which", ["stereo", "piv"])
def test_matching_leaves_of_a_wave_what_theory_says(which):
    rng = np.random.default_rng(3)
    settings = getattr(Settings(), which)
    size = 600
    x, y = rng.uniform(-5, size + 5, (2, int(0.03 * size**2)))
    first = photograph(x, y, size)
    for wanted in (0.9, 0.6, 0.35):
        k = np.linspace(0.05, 2.5, 500)
        wave = float(k[np.argmin(np.abs(matched(settings, k, 0 * k) - wanted))])  # rad per block
        moved = photograph(x + 0.2 * np.cos(wave / BLOCK * x), y, size)
        found = matching.match(first, moved, settings)
        inner = (slice(12, -12), slice(12, -12))
        phase = np.exp(1j * wave / BLOCK * found.x)[None, 12:-12]
        gain = 2 * np.mean(found.u[inner] * phase.conj()).real / 0.2
        assert gain == pytest.approx(wanted, abs=0.08), wanted


def cube_of(scene):
    recipe = {
        "rig": {name: camera.to_dict() for name, camera in scene.build_rig().cameras.items()},
        "grid": {"x": list(scene.grid.x), "y": list(scene.grid.y), "step": scene.grid.step},
        "settings": Settings().to_dict(),
    }
    return xr.Dataset(attrs={"recipe": json.dumps(recipe)})


def test_the_gain_follows_from_the_recipe():
    scene = Scene.load("demo")
    gain = predicted_gain(cube_of(scene))
    assert wv.read_gain(gain) is gain
    for name in ("gain_z", "gain_u", "gain_v", "gain_w"):
        np.testing.assert_allclose(gain[name][:, 0], 1, atol=0.01)
        assert (gain[name].sel(k=2 * np.pi * 8, method="nearest") > 0.9).all()
        assert float(gain[name][:, -1].max()) < 0.05
    # oblique cameras have pixels that are longer along x on the water
    short = gain.gain_w.sel(k=2 * np.pi * 25, method="nearest")
    assert float(short.sel(direction=0)) < float(short.sel(direction=np.pi / 2)) - 0.1
    # pixels of twice the size
    coarse = predicted_gain(cube_of(scene.with_(rig={"scale": 0.5})))
    assert float((gain.gain_w - coarse.gain_w).sel(k=2 * np.pi * 15, method="nearest").min()) > 0.2


def test_a_cube_that_does_not_say_how_it_was_made_is_refused():
    with pytest.raises(CubeError, match="does not say how it was made"):
        predicted_gain(xr.Dataset())
