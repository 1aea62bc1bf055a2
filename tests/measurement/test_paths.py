import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import spline_filter

from wavefield.measurement.paths import EVEN_TIMES, path_weights, read_path
from wavefield.measurement.regrid import BlockLattice

EVEN = path_weights(EVEN_TIMES, 6)
LATTICE = BlockLattice(2.0, 2.0, 5.0, (60, 60))
MIDDLE = 150.0
JITTER = st.lists(st.floats(-0.2, 0.2), min_size=6, max_size=6).map(lambda e: EVEN_TIMES + e)
USED = {2: (2, 3), 3: (1, 2, 3), 4: (1, 2, 3, 4), 6: (0, 1, 2, 3, 4, 5)}


def coefficients(fields):
    """Of cubic splines through fields (2, ny, nx), exactly, as (ny, nx, 2)."""
    return np.stack([spline_filter(one, mode="reflect") for one in fields], axis=-1).astype(np.float32)


def turned(angle):
    """Displacement of every block of a body that turns about the middle."""
    x, y = np.meshgrid(LATTICE.x - MIDDLE, LATTICE.y - MIDDLE)
    c, s = np.cos(angle) - 1.0, np.sin(angle)
    return coefficients([c * x - s * y, s * x + c * y])


def error(angle, times, there, read):
    """Of a body that turns by an angle per interval, seen at these times."""
    splines = [turned(angle * span) if q else None for span, q in zip(np.diff(times), there)]
    everywhere = [np.ones(LATTICE.shape, bool) if q else None for q in there]
    X, Y = np.meshgrid(np.linspace(110.0, 190.0, 5), np.linspace(110.0, 190.0, 5))
    d, _ = read(splines, everywhere, LATTICE, X, Y)
    exact = angle * np.stack([-(Y - MIDDLE), X - MIDDLE])
    size = np.abs(exact).max()
    p = np.stack([X - MIDDLE, Y - MIDDLE])
    c, s = np.cos(angle * times), np.sin(angle * times)
    places = [np.stack([c[n] * p[0] - s[n] * p[1], s[n] * p[0] + c[n] * p[1]]) - p for n in (2, 3)]
    return (
        float(np.abs(d[:2] - exact).max() / size),
        float(np.abs(d[4:] - 0.5 * (places[0] + places[1])).max() / size),
        float(np.abs(d[2:4] - (places[1] - places[0])).max() / size),
    )


def test_a_turning_body_keeps_third_order_in_time():
    def off(angle, *there):
        return error(angle, EVEN_TIMES, there, lambda *a: read_path(*a, path_weights(EVEN_TIMES, 6)))[0]

    # chords are p^2/24 short and lie beside the path by p^2/8; four places leave terms in p^4
    assert off(0.2, False, True, False) == pytest.approx(0.2**2 / 12, rel=0.05)
    for places in (4, 6):
        there = [True] * (places - 1)
        assert off(0.2, *there) < 0.2**4
        assert off(0.1, *there) < 0.1 * off(0.2, *there)


@given(JITTER, st.sampled_from([2, 3, 4, 6, -3]))
@settings(max_examples=25, deadline=None)
def test_paths_through_frames_at_uneven_times_are_as_exact_as_through_even_ones(times, places):
    there = {2: "00100", 3: "01100", -3: "00110", 4: "01110", 6: "11111"}[places]
    there = [q == "1" for q in there]
    limit = {2: 0.03, 3: 3e-3, 4: 5e-4, 6: 5e-4}[abs(places)]
    uneven = error(0.1, times, there, lambda *a: read_path(*a, path_weights(times, 6)))
    assert max(uneven) < limit
    # and through the same places as where times are taken for even
    used = list(USED.get(places, ()))
    if places in (4, 6) and np.abs(times - EVEN_TIMES)[used].max() > 0.1:
        assert max(error(0.1, times, there, lambda *a: read_path(*a, EVEN))) > 3 * max(uneven)


def test_water_that_was_not_in_the_image_was_not_measured():
    rng = np.random.default_rng(3)
    at = rng.uniform(0.0, 299.0, (2, 400)).astype(np.float32)
    moved = rng.uniform(-50.0, 50.0, 2)
    spline = coefficients([np.full(LATTICE.shape, one) for one in moved])
    measured = np.ones(LATTICE.shape, bool)
    _, block = read_path([spline] * 5, [measured] * 5, LATTICE, *at, EVEN)
    places = at + np.multiply.outer(np.arange(-2, 3) - 0.5, moved)[..., None]  # where each step departs
    inside = ((places > -0.5) & (places < 299.5)).all(axis=1)
    inside[[0, 4]] = inside[[0, 1, 3, 4]].all(axis=0)
    np.testing.assert_array_equal((block >= 0)[[0, 1, 3, 4]], inside[[0, 1, 3, 4]])
    assert 0 < inside[1].sum() < inside[2].sum() < 400


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
            list(fields), list(random.random((places - 1, *LATTICE.shape)) < 0.7), LATTICE, X, Y, EVEN
        )
        assert np.isnan(d[:, ::17]).all()
        assert -1 <= block.min() <= block.max() < np.prod(LATTICE.shape)
