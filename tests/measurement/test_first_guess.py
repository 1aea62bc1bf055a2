from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from wavefield import matching
from wavefield.grid import Grid
from wavefield.measurement import GridGeometry, Settings
from wavefield.measurement.search_range import first_guess, search_widened, wide_enough
from wavefield.tank import paper_rig


def photograph(seed=0, size=640):
    rng = np.random.default_rng(seed)
    beads = np.zeros((size, size), np.float32)
    beads[rng.integers(0, size, size * 20), rng.integers(0, size, size * 20)] = 1.0
    return 200 * ndimage.gaussian_filter(beads, 1.1).astype(np.float32) + 10


def moved(image, dx, dy):
    return np.roll(image, (dy, dx), (0, 1))


def guess(*steps):
    """Of a record of one camera, whose every step moves as stated."""
    frames = {}
    for k, (dx, dy) in enumerate(steps):
        frames[2 * k] = photograph(k)
        frames[2 * k + 1] = moved(frames[2 * k], dx, dy)
    return first_guess(lambda name, frame: frames[frame], ["cam1"], [2 * k for k in range(len(steps))])


def test_a_sea_that_moves_both_ways_widens_the_search_both_ways():
    found = guess((40, 0), (-38, 6))
    assert (found.x, found.y) == ((-38, 40), (0, 6))
    low, high = wide_enough(Settings(), found).piv.search_x
    assert low < -38 - 12
    assert high > 40 + 12
    assert "-38 to +40 px along x" in found.sentence


@pytest.mark.parametrize("shift", [30, 200])
def test_real_texture_is_measured_however_far_it_moves(shared, shift):
    from wavefield.images import read_image

    folder = shared / "data" / "piv_samples" / "Milestone" / "Images"
    image = read_image(sorted(p for p in folder.rglob("*") if p.suffix in (".png", ".tif"))[0]).astype(
        np.float32
    )
    left = shift // 2
    first, second = image[:, left + shift : -1 - left], image[:, left : image.shape[1] - 1 - left - shift]
    frames = {0: np.ascontiguousarray(first), 1: np.ascontiguousarray(second)}
    found = first_guess(lambda name, frame: frames[frame], ["cam1"], [0])
    settings = wide_enough(Settings(), found).piv
    match = matching.match(frames[0], frames[1], settings)
    inside = (match.x > 30)[None, :] & (match.x < first.shape[1] - shift - 40)[None, :]
    inside = inside & np.ones(match.u.shape, bool)
    inside[:6], inside[-6:] = False, False
    assert match.valid[inside].mean() > 0.98
    assert np.sqrt(np.mean((match.u - shift)[inside & match.valid] ** 2)) < 0.02


def test_a_measurement_without_a_stated_range_finds_it_in_its_frames():
    rig = paper_rig(0.5, crop=0.6)
    grid = Grid(x=(-0.1, 0.1), y=(-0.08, 0.08), step=0.01)
    geometry = GridGeometry(rig, grid)
    width, height = rig["cam1"].size

    def step(dx, dy):
        first = {name: photograph(k) for k, name in enumerate(rig)}
        second = {name: moved(image, dx, dy) for name, image in first.items()}
        return tuple({n: image[:height, :width] for n, image in one.items()} for one in (first, second))

    far, near = [step(50, -30)], [step(3, 2)]
    found = search_widened(far, geometry)
    assert found.settings.piv.search_x[1] > 60
    assert found.settings.piv.search_y[0] < -40
    assert search_widened(near, geometry) is geometry
    stated = Settings(piv=replace(Settings().piv, search_x=(-20.0, 20.0)), z_range=(-0.05, 0.05))
    own = GridGeometry(rig, grid, stated)
    assert search_widened(far, own) is own
