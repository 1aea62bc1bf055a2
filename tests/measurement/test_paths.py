import numpy as np
import pytest
from scipy.ndimage import spline_filter

from wavefield.measurement.paths import path_weights, read_path
from wavefield.measurement.regrid import BlockLattice

LATTICE = BlockLattice(2.0, 2.0, 5.0, (60, 60))
MIDDLE = 150.0


def coefficients(fields):
    """Of cubic splines through fields (2, ny, nx), exactly, as (ny, nx, 2)."""
    return np.stack([spline_filter(one, mode="reflect") for one in fields], axis=-1).astype(np.float32)


def turned(angle):
    """Displacement of every block of a body that turns about the middle."""
    x, y = np.meshgrid(LATTICE.x - MIDDLE, LATTICE.y - MIDDLE)
    c, s = np.cos(angle) - 1.0, np.sin(angle)
    return coefficients([c * x - s * y, s * x + c * y])


def error(angle, *there):
    spline, all_of_it = turned(angle), np.ones(LATTICE.shape, bool)
    X, Y = np.meshgrid(np.linspace(110.0, 190.0, 7), np.linspace(110.0, 190.0, 7))
    splines, measured = ([one if q else None for q in there] for one in (spline, all_of_it))
    d, _ = read_path(splines, measured, LATTICE, X, Y, path_weights(frames=6))
    exact = angle * np.stack([-(Y - MIDDLE), X - MIDDLE])
    return float(np.abs(d[:2] - exact).max() / np.abs(exact).max())


def test_a_turning_body_keeps_third_order_in_time():
    # chords are p^2/24 short and lie beside the path by p^2/8; four places leave terms in p^4
    assert error(0.2, False, True, False) == pytest.approx(0.2**2 / 12, rel=0.05)
    for places in (4, 6):
        there = [True] * (places - 1)
        assert error(0.2, *there) < 0.2**4
        assert error(0.1, *there) < 0.1 * error(0.2, *there)


@pytest.mark.parametrize("places", [2, 4, 6])
def test_displacements_that_are_not_finite_or_absurd_lead_out_of_no_array(places):
    random = np.random.default_rng(places)
    X, Y = random.uniform(-400.0, 700.0, (2, 2000)).astype(np.float32)
    X[::17] = np.nan
    for _ in range(20):
        fields = random.normal(0, 10.0 ** random.uniform(-2, 4), (places - 1, *LATTICE.shape, 2)).astype("f4")
        faulty = random.random(fields.shape) < random.choice([0.0, 0.1, 0.9])
        fields[faulty] = random.choice([np.nan, np.inf, -np.inf, 3e38])
        d, block = read_path(
            list(fields), list(random.random((places - 1, *LATTICE.shape)) < 0.7), LATTICE, X, Y
        )
        assert np.isnan(d[:, ::17]).all()
        assert -1 <= block.min() <= block.max() < np.prod(LATTICE.shape)
