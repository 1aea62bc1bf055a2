import numpy as np
import pytest
import scipy.fft

from wavefield.measurement.regrid import (
    BlockLattice,
    blocks_below,
    coefficients,
    push_pull,
    read_surface,
    thin_plate,
)


@pytest.fixture(scope="module")
def lattice():
    return BlockLattice(x0=-0.5, y0=-0.4, step=0.01, shape=(81, 101))


def wave(x, y):
    return 0.02 * np.sin(9.0 * x + 4.0 * y) + 0.01 * np.cos(7.0 * y - 2.0 * x)


def spline_of(field, smoothing=0.0):
    field = field[..., None].astype(np.float32)
    if smoothing:
        waves = scipy.fft.dctn(field, axes=(0, 1), norm="ortho")
        waves *= (thin_plate(field.shape[:2], smoothing) / thin_plate(field.shape[:2], 0.0))[..., None]
        field = scipy.fft.idctn(waves, axes=(0, 1), norm="ortho")
    return coefficients(field)


@pytest.mark.parametrize("centre", [(0.0, 0.0, 4.0), (3.0, 0.1, 3.0), (-3.0, 0.5, 3.0)])
def test_nodes_are_read_where_their_line_of_sight_meets_the_surface(lattice, centre):
    # the lattice holds z at apparent positions: x_a = x - D_a z, solved here the slow way
    centre = np.array(centre)
    xa, ya = np.meshgrid(lattice.x, lattice.y)
    z = np.zeros_like(xa)
    for _ in range(60):
        z = wave(xa + (xa - centre[0]) / -centre[2] * z, ya + (ya - centre[1]) / -centre[2] * z)
    x, y = np.meshgrid(np.linspace(-0.35, 0.35, 15), np.linspace(-0.3, 0.3, 13))
    values = read_surface(spline_of(z), lattice, centre, x, y)
    np.testing.assert_allclose(values, wave(x, y), atol=2e-6)
    _, column = np.unravel_index(blocks_below(lattice, centre, x, y, values)[0], lattice.shape)
    apparent = centre[0] + (x - centre[0]) / (1 - wave(x, y) / centre[2])
    assert np.abs(lattice.x[column] - apparent).max() <= 0.5 * lattice.step + 1e-5


def test_the_spline_passes_through_the_values_and_smoothing_halves_its_wave(lattice):
    rng = np.random.default_rng(0)
    field = rng.standard_normal(lattice.shape).astype(np.float32)
    x, y = np.meshgrid(lattice.x[5:-5], lattice.y[5:-5])
    above = np.array([0.0, 0.0, 1e9])
    # field 0 is the elevation of a camera straight above, infinitely far: nothing is displaced
    values = read_surface(spline_of(1e-3 * field), lattice, above, x, y)
    np.testing.assert_allclose(values, 1e-3 * field[5:-5, 5:-5], atol=2e-6)
    n = np.arange(lattice.shape[1])
    k = np.pi * 20 / lattice.shape[1]
    cosine = np.broadcast_to(1e-3 * np.cos(k * (n + 0.5)), lattice.shape)
    values = read_surface(spline_of(cosine, smoothing=k**-4), lattice, above, x, y)
    np.testing.assert_allclose(values, 0.5 * cosine[5:-5, 5:-5], atol=2e-6)


def test_gaps_are_filled_by_local_means_and_nothing_by_nothing(lattice):
    x, y = np.meshgrid(lattice.x, lattice.y)
    z = wave(x, y)
    valid = np.hypot(x - 0.1, y) > 0.05
    filled = push_pull(np.where(valid, z, np.nan)[..., None].astype(np.float32), valid)
    np.testing.assert_array_equal(filled[valid, 0], z[valid].astype(np.float32))
    assert np.abs(filled[~valid, 0] - z[~valid]).max() < 0.008
    nothing = np.full((*lattice.shape, 1), np.nan, np.float32)
    assert (push_pull(nothing, np.zeros(lattice.shape, bool)) == 0).all()
