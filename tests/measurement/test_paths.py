"""Velocity along paths: a cubic in time through four places."""

import numpy as np
import pytest

from wavefield.measurement.paths import read_path
from wavefield.measurement.regrid import Lattice, coefficients

LATTICE = Lattice(2.0, 2.0, 5.0, (60, 60))
MIDDLE = 150.0


def turned(angle):
    """Displacement of every block of a body that turns about the middle."""
    x, y = np.meshgrid(LATTICE.x - MIDDLE, LATTICE.y - MIDDLE)
    c, s = np.cos(angle) - 1.0, np.sin(angle)
    return coefficients(np.stack([c * x - s * y, s * x + c * y], axis=-1).astype(np.float32))


def error(angle, before=True, after=True):
    spline, all_of_it = turned(angle), np.ones(LATTICE.shape, bool)
    X, Y = np.meshgrid(np.linspace(110.0, 190.0, 7), np.linspace(110.0, 190.0, 7))
    there = (before, True, after)
    d, _ = read_path(
        [spline if q else None for q in there], [all_of_it if q else None for q in there], LATTICE, X, Y
    )
    exact = angle * np.stack([-(Y - MIDDLE), X - MIDDLE])
    return float(np.abs(d - exact).max() / np.abs(exact).max())


def test_a_turning_body_keeps_third_order_in_time():
    # chords are p^2/24 short and lie beside the path by p^2/8; four places leave terms in p^4
    assert error(0.2, before=False, after=False) == pytest.approx(0.2**2 / 12, rel=0.05)
    assert error(0.2) < 0.2**4
    assert error(0.1) < 0.1 * error(0.2)


@pytest.mark.parametrize("there", [(False, True), (True, False)])
def test_at_an_end_a_parabola_finds_the_place_and_leaves_the_chord(there):
    # p^2/24 of the velocity is missing, and the particle is p^3/16 of its way beside
    assert error(0.2, *there) == pytest.approx(0.2**2 / 24 + 0.2**3 / 16, rel=0.2)


def test_what_was_not_measured_is_not_asked():
    spline = turned(0.3)
    wrong = turned(-0.3)
    nowhere, everywhere = np.zeros(LATTICE.shape, bool), np.ones(LATTICE.shape, bool)
    X = np.array([130.0, np.nan])
    found, block = read_path((wrong, spline, spline), (nowhere, everywhere, everywhere), LATTICE, X, X)
    parabola, _ = read_path((None, spline, spline), (None, everywhere, everywhere), LATTICE, X, X)
    np.testing.assert_array_equal(found, parabola)
    assert block[0, 0] == -1
    assert np.isnan(found[:, 1]).all()
