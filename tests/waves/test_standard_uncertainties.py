"""Standard uncertainties of what is quoted of a sea, judged on independent random seas."""

import numpy as np
import pytest
from independent_seas import Sea, still_frequency

import wavefield as wf
from wavefield.waves.moments import peak_and_std


@pytest.fixture(scope="module")
def seas():
    """Errors over standard uncertainties of 6 seas, by quantity."""
    out = {"Hs": [], "slope": [], "direction": []}
    for seed in range(6):
        heading, s = 2.5 * seed, 5.0
        sea = Sea(
            directions=((heading, s, 1.0),),
            lowest=1.3,
            highest=3.6,
            slope=4.0,
            shape=(512, 20, 24),
            dx=0.04,
            waves=1500,
            seed=seed,
        )
        kx, ky, a = sea.components()
        k = np.hypot(kx, ky)
        f = still_frequency(k, sea.depth) / (2 * np.pi)
        energy = (np.abs(a) ** 2 / 2 / f**-sea.slope).mean() * f**-sea.slope  # expected of each wave
        cube = sea.cube(("z",))
        spectrum = wf.spectrum(cube.z)
        found = wf.statistics(cube)
        towards = wf.directions(spectrum, [2.0], current=(0.0, 0.0))
        true = 4 * np.sqrt(energy.sum())
        out["Hs"].append(float((found.significant_height - true) / found.significant_height_std))
        true = (k**2 * energy).sum()
        out["slope"].append(float((found.mean_square_slope - true) / found.mean_square_slope_std))
        error = (float(towards.direction[0]) - heading + np.pi) % (2 * np.pi) - np.pi
        out["direction"].append(error / float(towards.direction_std[0]))
    return {name: np.array(values) for name, values in out.items()}


@pytest.mark.parametrize("name", ["Hs", "slope", "direction"])
def test_errors_are_those_that_are_stated(seas, name):
    assert 0.5 < np.sqrt((seas[name] ** 2).mean()) < 1.6
    together = np.concatenate(list(seas.values()))
    assert 0.5 < (np.abs(together) < 1).mean() < 0.86


def test_a_peak_lies_between_lines_and_is_as_certain_as_its_neighbours_differ():
    omega, every, dof = np.arange(60) * 0.4, np.ones(60, bool), np.full(60, 60.0)
    sharp, broad = (np.exp(-(((omega - 9.31) / width) ** 2)) for width in (0.5, 3.0))
    found, stds = zip(*(peak_and_std(E, every, dof, omega) for E in (sharp, broad)))
    assert found == pytest.approx((9.31, 9.31), abs=1e-6)
    assert 0.01 < stds[0] < 0.4 / np.sqrt(12)
    assert stds[1] > 3 * stds[0]
    assert peak_and_std(broad, every, dof / 9, omega)[1] > 1.3 * stds[1]
    assert peak_and_std(broad, omega > 9.5, dof, omega)[0] == pytest.approx(
        9.4
    )  # half a line of what is valid
