"""Palettes, colour limits and streamlines of the map; averages over time."""

import numpy as np
import pytest
from explorer_cases import make_cube
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from scipy import signal

from wavefield.errors import StoreError
from wavefield.explorer import selections
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import colour_limits, palette, streamlines
from wavefield.explorer.place import COLOUR_MAPS, Place
from wavefield.explorer.save import map_of
from wavefield.explorer.whole_record import AverageRequest, averages, index_of, phases_of

X, Y = np.linspace(-0.5, 0.5, 41), np.linspace(-0.4, 0.4, 33)
GX, GY = np.meshgrid(X, Y)


@pytest.mark.parametrize("name", [name for name in COLOUR_MAPS if name])
def test_colours_are_those_of_matplotlib_which_saved_maps_have(name):  # of two versions of cividis
    drawn = np.array([to_rgb(colour) for colour in palette(name)])
    np.testing.assert_allclose(drawn, colormaps[name](np.linspace(0, 1, 256))[:, :3], atol=0.1)


def pieces(xs, ys):
    """The lines between the gaps, (2, n) each, and the arrow heads."""
    ends = np.flatnonzero(np.isnan(xs))
    parts = np.split(np.array([xs, ys]), ends + 1, axis=1)
    lines = [part[:, :-1] for part in parts[:-1]]
    return lines[::2], lines[1::2]


def test_streamlines_of_a_vortex_are_circles_in_its_sense():
    lines, heads = pieces(*streamlines(-GY, GX, X, Y))
    assert len(lines) > 20
    for line in lines:
        radius = np.hypot(*line)
        if radius.mean() > 0.05:  # two nodes
            assert np.ptp(radius) < 0.01 * radius.mean() + 0.002
        turn = np.diff(np.unwrap(np.arctan2(line[1], line[0])))
        assert (turn > 0).all()
    assert len(heads) == len(lines)


def test_streamlines_end_at_gaps_and_cover_the_rest():
    u, v = np.ones_like(GX), np.zeros_like(GX)
    u[10:20, 15:25] = np.nan
    xs, ys = streamlines(u, v, X, Y)
    gap = (np.abs(xs - X[20]) < 0.1) & (ys > Y[10]) & (ys < Y[19])
    assert not gap.any()
    assert np.histogram(ys[np.isfinite(ys)], 8, (Y[0], Y[-1]))[0].min() > 20
    assert streamlines(np.full_like(GX, np.nan), v, X, Y)[0].size == 0
    assert streamlines(0 * u, v, X, Y)[0].size == 0


def test_logarithmic_limits_are_positive_and_hold_the_values():
    values = np.random.default_rng(1).lognormal(0, 2, (30, 40)) * np.random.default_rng(2).choice(
        [-1, 1], (30, 40)
    )
    low, high = colour_limits(values, signed=False, log=True)
    assert 0 < low < high
    inside = (np.abs(values) >= low) & (np.abs(values) <= high)
    assert inside.mean() > 0.95
    low, high = colour_limits(np.zeros((3, 3)), signed=False, log=True)
    assert 0 < low < high


@pytest.mark.parametrize("steps", [64, 333, 2000])
def test_spectra_are_those_of_scipy(steps):
    values = np.random.default_rng(steps).normal(size=(steps, 3))
    found = selections.spectrum(values, 0.05)
    segment = round(1 / (found.frequency[0] * 0.05))
    _, density = signal.welch(values.T, fs=20.0, nperseg=segment, detrend="constant")
    np.testing.assert_allclose(found.density, density.mean(axis=0)[1:], rtol=1e-10)


def test_averages_over_time_are_those_of_numpy(tmp_path):
    fields = make_cube(tmp_path / "cube.zarr")
    record, done = CubeRecord(tmp_path / "cube.zarr"), []
    found = averages(record, AverageRequest(("w", "z", "vorticity"), 0), done.append)
    for name in ("w", "z"):
        values = fields[name].astype(float)
        with np.errstate(invalid="ignore"):
            mean, rms = values.mean(axis=0), values.std(axis=0)
        np.testing.assert_allclose(found[name][0], mean, atol=2e-5)
        np.testing.assert_allclose(found[name][1], rms, atol=2e-5)
    vorticity = record.steps("vorticity", 0, record.layout.steps)  # at once, not by chunks
    np.testing.assert_allclose(found["vorticity"][0], vorticity.mean(axis=0), rtol=1e-4, atol=1e-5)
    assert done[-1] == 1.0


def test_phase_averages_are_those_of_the_waves_of_the_period_alone(tmp_path):
    make_cube(tmp_path / "cube.zarr")
    record, done = CubeRecord(tmp_path / "cube.zarr"), []
    period = 24 * float(np.diff(record.time).mean())
    found = averages(record, AverageRequest(("z",), 0, period), done.append)["z"]
    steps = record.steps("z", 0, record.layout.steps).astype(float)
    assert len(found) == phases_of(period, record.frame_rate) == 24
    # steps half a step from a phase contribute to it and to the next one alike
    for k in (0, 7, 23):
        alike = 0.5 * (steps[k::24].mean(axis=0) + steps[(k - 1) % 24 :: 24].mean(axis=0))
        np.testing.assert_allclose(found[k], alike, atol=2e-4)
    assert done[-1] == 1.0


def test_the_saved_map_of_a_phase_average_is_the_one_that_is_shown(tmp_path):
    make_cube(tmp_path / "cube.zarr")
    record = CubeRecord(tmp_path / "cube.zarr")
    place = Place("z", 3, average="phase", period=0.8)
    shown = averages(record, AverageRequest(("z",), 0, 0.8))["z"][index_of(record, place)]
    np.testing.assert_array_equal(map_of(record, place)["z"], shown)
    with pytest.raises(StoreError, match="needs the period"):
        map_of(record, Place("z", 3, average="phase"))
