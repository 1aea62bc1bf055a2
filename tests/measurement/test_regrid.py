import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wavefield.measurement.regrid import (
    Lattice,
    bending_energy,
    coefficients,
    fill,
    levelled,
    push_pull,
    read_anchored,
    read_surface,
    thin_plate,
)


@pytest.fixture(scope="module")
def lattice():
    return Lattice(x0=-0.5, y0=-0.4, step=0.01, shape=(81, 101))


def wave(x, y):
    return 0.02 * np.sin(9.0 * x + 4.0 * y) + 0.01 * np.cos(7.0 * y - 2.0 * x)


def spline_of(field, smoothing=0.0):
    return coefficients(field[..., None].astype(np.float32), thin_plate(field.shape, smoothing))


@pytest.mark.parametrize("centre", [(0.0, 0.0, 4.0), (3.0, 0.1, 3.0), (-3.0, 0.5, 3.0)])
def test_nodes_are_read_where_their_line_of_sight_meets_the_surface(lattice, centre):
    # the lattice holds z at apparent positions: x_a = x - D_a z, solved here the slow way
    centre = np.array(centre)
    xa, ya = np.meshgrid(lattice.x, lattice.y)
    z = np.zeros_like(xa)
    for _ in range(60):
        z = wave(xa + (xa - centre[0]) / -centre[2] * z, ya + (ya - centre[1]) / -centre[2] * z)
    x, y = np.meshgrid(np.linspace(-0.35, 0.35, 15), np.linspace(-0.3, 0.3, 13))
    values, block = read_surface(spline_of(z), lattice, centre, x, y)
    np.testing.assert_allclose(values[0], wave(x, y), atol=2e-6)
    _, column = np.unravel_index(block, lattice.shape)
    apparent = centre[0] + (x - centre[0]) / (1 - wave(x, y) / centre[2])
    assert np.abs(lattice.x[column] - apparent).max() <= 0.5 * lattice.step + 1e-5


@given(st.floats(-6, 6), st.floats(-6, 6), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_displacement_is_read_where_the_path_has_its_middle(a, b, p, q):
    # u = a + p X, v = b + q Y: the path through X at its middle starts at (X - a / 2) / (1 + p / 2)
    lattice = Lattice(2.0, 2.0, 5.0, (60, 60))
    x, y = np.meshgrid(lattice.x, lattice.y)
    fields = np.stack([a + p * x, b + q * y], axis=-1).astype(np.float32)
    spline = coefficients(fields, thin_plate(lattice.shape, 0.0))
    X, Y = np.meshgrid(np.linspace(100.0, 200.0, 4), np.linspace(100.0, 200.0, 3))
    values, _ = read_anchored(spline, lattice, X, Y, steps=12)
    np.testing.assert_allclose(values[0], a + p * (X - a / 2) / (1 + p / 2), atol=5e-3)
    np.testing.assert_allclose(values[1], b + q * (Y - b / 2) / (1 + q / 2), atol=5e-3)


def test_two_steps_anchor_to_a_hundredth_of_a_pixel():
    lattice = Lattice(2.0, 2.0, 5.0, (80, 80))
    x, y = np.meshgrid(lattice.x, lattice.y)
    fields = np.stack([8 * np.sin(x / 60.0), 8 * np.cos(y / 70.0)], axis=-1).astype(np.float32)
    spline = coefficients(fields, thin_plate(lattice.shape, 0.0))
    X, Y = np.meshgrid(np.linspace(60.0, 340.0, 29), np.linspace(60.0, 340.0, 29))
    two, _ = read_anchored(spline, lattice, X, Y)
    many, _ = read_anchored(spline, lattice, X, Y, steps=30)
    none, _ = read_anchored(spline, lattice, X, Y, steps=0)
    assert np.abs(two - many).max() < 0.01
    assert np.abs(none - many).max() > 0.2
    assert np.isnan(read_anchored(spline, lattice, np.array([np.nan]), np.array([5.0]))[0]).all()


def test_the_spline_passes_through_the_values_and_smoothing_halves_its_wave(lattice):
    rng = np.random.default_rng(0)
    field = rng.standard_normal(lattice.shape).astype(np.float32)
    x, y = np.meshgrid(lattice.x[5:-5], lattice.y[5:-5])
    above = np.array([0.0, 0.0, 1e9])
    # field 0 is the elevation of a camera straight above, infinitely far: nothing is displaced
    values, _ = read_surface(spline_of(1e-3 * field), lattice, above, x, y)
    np.testing.assert_allclose(values[0], 1e-3 * field[5:-5, 5:-5], atol=2e-6)
    n = np.arange(lattice.shape[1])
    k = np.pi * 20 / lattice.shape[1]
    cosine = np.broadcast_to(1e-3 * np.cos(k * (n + 0.5)), lattice.shape)
    values, _ = read_surface(spline_of(cosine, smoothing=k**-4), lattice, above, x, y)
    np.testing.assert_allclose(values[0], 0.5 * cosine[5:-5, 5:-5], atol=2e-6)


def test_a_plane_bends_nowhere_and_fills_any_hole(lattice):
    region = np.ones(lattice.shape, bool)
    region[:, :7] = False
    energy = bending_energy(region)
    x, y = np.meshgrid(lattice.x, lattice.y)
    plane = 1.0 + 2.0 * x - 3.0 * y
    assert abs(plane.ravel() @ (energy @ plane.ravel())) < 1e-9
    valid = region.copy()
    valid[20:35, 30:52] = False
    valid[60:, 70:90] = False  # at the edge, where the plate is free
    fields = np.where(valid, plane, np.nan)[..., None].astype(np.float32)
    filled = fill(fields, valid, region, energy)
    np.testing.assert_allclose(filled[region & (y < 0.38), 0], plane[region & (y < 0.38)], atol=2e-3)
    assert np.isfinite(filled).all()


def test_a_hole_in_waves_is_filled_better_than_by_local_means(lattice):
    x, y = np.meshgrid(lattice.x, lattice.y)
    z = wave(x, y)
    valid = np.hypot(x - 0.1, y) > 0.05
    fields = np.where(valid, z, np.nan)[..., None].astype(np.float32)
    plate = fill(fields, valid, np.ones_like(valid), bending_energy(np.ones_like(valid)))
    mean = push_pull(fields, valid)
    hole = ~valid
    assert np.abs(plate[hole, 0] - z[hole]).max() < 6e-4
    assert np.abs(plate[hole, 0] - z[hole]).max() < 0.3 * np.abs(mean[hole, 0] - z[hole]).max()
    np.testing.assert_array_equal(plate[valid, 0], z[valid].astype(np.float32))


def test_nothing_measured_fills_nothing(lattice):
    nothing = np.zeros(lattice.shape, bool)
    filled = fill(
        np.full((*lattice.shape, 1), np.nan, np.float32), nothing, ~nothing, bending_energy(~nothing)
    )
    assert np.isfinite(filled).all()


def test_uncertainty_is_shared_with_the_blocks_around_and_reaches_into_holes():
    std = np.full((30, 40), 0.02, np.float32)
    std[:, ::2] = 0.04
    valid = np.ones(std.shape, bool)
    valid[10:18, 10:18] = False
    std[~valid] = np.nan
    found = levelled(std, valid)
    np.testing.assert_allclose(found, 0.03, rtol=0.05)


def test_one_uncertain_block_keeps_its_own_uncertainty_without_spoiling_the_rest():
    std = np.full((30, 40), 0.03, np.float32)
    std[15, 20] = 3.0
    found = levelled(std, np.ones(std.shape, bool))
    assert found[15, 20] >= 1.5
    found[15, 20] = 0.03
    assert found.max() < 0.035
