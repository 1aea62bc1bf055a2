import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from independent_seas import Sea
from waves_cases import linear_cube, random_waves

import wavefield.waves as wv
from wavefield.errors import CubeError
from wavefield.grid import largest_rectangle
from wavefield.variables import FrameStatus, Quality
from wavefield.waves.record import find_record
from wavefield.waves.spectra import total


@pytest.fixture(scope="module")
def sea():
    return linear_cube(random_waves(n=60), 300, 30, 40, dx=0.03)


@given(arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_the_largest_rectangle_is_full_and_none_is_larger(mask):
    (y0, y1), (x0, x1) = largest_rectangle(mask)
    assert mask[y0:y1, x0:x1].all()
    best = 0
    for a in range(mask.shape[0]):
        for b in range(a + 1, mask.shape[0] + 1):
            for c in range(mask.shape[1]):
                for d in range(c + 1, mask.shape[1] + 1):
                    if mask[a:b, c:d].all():
                        best = max(best, (b - a) * (d - c))
    assert (y1 - y0) * (x1 - x0) == best


def test_empty_edges_are_cut_off_and_single_holes_filled(sea):
    holed = sea.copy(deep=True)
    holed["w"][:, :4] = np.nan
    holed["z"][:, :, 35:] = np.nan
    holed["u"][123, 20, 20] = np.nan
    record = find_record(holed)
    assert record.y == (4, 30)
    assert record.x == (0, 35)
    assert record.runs == ((0, 300),)
    assert record.holes == 1
    inner = sea.isel(y=slice(4, 30), x=slice(0, 35))
    np.testing.assert_array_equal(
        wv.komega(holed.w, segment=64, record=record).E, wv.komega(inner.w, segment=64).E
    )


def test_short_gaps_are_bridged_and_reported_long_ones_split_the_record(sea):
    gappy = sea.copy(deep=True)
    gappy["z"][50:52] = np.nan
    gappy["w"][150:160] = np.nan
    record = find_record(gappy)
    assert record.bridged == (50, 51)
    assert record.runs == ((0, 150), (160, 300))
    E = wv.komega(gappy.z, segment=64, record=record)
    assert E.attrs["steps_bridged"] == 2
    assert E.attrs["segments"] == 6
    whole = wv.komega(sea.z, segment=64)
    assert float(total(E.E) / total(whole.E)) == pytest.approx(1, abs=0.1)


def test_steps_that_failed_do_not_count_even_if_they_hold_numbers(sea):
    status = np.full(300, FrameStatus.DONE, "u1")
    status[100:140] = FrameStatus.FAILED
    status[200] = FrameStatus.DONE_WITH_FAULTS
    record = find_record(sea.assign(frame_status=("time", status)))
    assert record.runs == ((0, 100), (140, 300))


def test_nodes_that_come_and_go_are_left_out(sea):
    flickering = sea.copy(deep=True)
    flickering["v"][::3, 0] = np.nan
    assert find_record(flickering).y == (1, 30)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda c: c.drop_vars("x"), "no coordinate 'x'"),
        (lambda c: c.rename(x="easting"), "'x' is missing"),
        (lambda c: c.assign_coords(time=c.time**1.01), "steps of 'time' are unequal"),
        (lambda c: c.isel(time=[0, 1, 2, 5, 6, 7]), "steps of 'time' are unequal"),
        (lambda c: c.isel(y=slice(None, None, -1)), "'y' runs backwards"),
        (lambda c: c.assign_coords(time=c.time.values.astype("M8[s]")), "must be in seconds"),
        (lambda c: c * np.nan, "no step of the cube holds a single value"),
        (lambda c: c.where((c.x * 100 + c.y * 100) % 12 > 3), "largest rectangle"),
        (lambda c: c.isel(time=slice(0, 1)), "at least two"),
        (lambda c: xr.Dataset({"other": c.z}), "none of z"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_sentence(sea, spoil, sentence):
    with pytest.raises(CubeError, match=sentence) as caught:
        find_record(spoil(sea))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("segment", "sentence"),
    [(512, "300 steps, less than one segment of 512: choose a segment of at most 300"), (63, "even number")],
)
def test_a_segment_that_does_not_fit_is_refused(sea, segment, sentence):
    with pytest.raises(CubeError, match=sentence):
        wv.komega(sea.w, segment=segment)


def test_any_order_of_dimensions_will_do(sea):
    turned = sea.w.transpose("x", "time", "y")
    np.testing.assert_array_equal(wv.komega(turned, segment=64).E, wv.komega(sea.w, segment=64).E)


def with_mask(sea, masked):
    """The sea without what is masked, as a run leaves it."""
    masked = xr.DataArray(masked, dims=("time", "y", "x"))
    quality = xr.where(masked, int(Quality.MASKED), int(Quality.MEASURED)).astype("u2")
    return sea.where(~masked).assign(quality=quality)


def test_what_is_masked_for_a_few_steps_is_not_filled_but_left_out(sea):
    masked = np.zeros(sea.z.shape, bool)
    masked[20:26, 5, 7] = True  # a float drifts by, under a tenth of the time
    record = find_record(with_mask(sea, masked))
    y, x = record.y, record.x
    assert not any(masked[a:b, y[0] : y[1], x[0] : x[1]].any() for a, b in record.runs)
    assert record.holes == 0


@pytest.mark.parametrize("fraction", [1e-5, 0.2])
def test_nodes_missing_at_random_cost_no_step_and_leave_the_spectrum(fraction):
    seed = 70510
    sea = Sea(seed=seed, highest=3.5, noise=5e-5, shape=(160, 48, 64), waves=250, depth=0.7, slope=6)
    whole = sea.cube(("z",)).z
    missing = xr.DataArray(np.random.default_rng(seed).random(sea.shape) < fraction, dims=whole.dims)
    holed = whole.where(~missing)
    record = find_record(holed)
    assert record.shape == (48, 64)
    assert record.runs == ((0, 160),)
    assert record.holes == int(missing.sum())
    spectra = [wv.E_omega(wv.komega(z, segment=80)) for z in (whole, holed)]
    ratio = spectra[1].E / spectra[0].E
    waves, floor = ((ratio.frequency > a) & (ratio.frequency < b) for a, b in ((1.2, 3.4), (5, 7)))
    assert float(abs(ratio - 1).where(waves).max()) < 2e-3
    assert float(ratio.where(floor).max()) < 2
    assert bool(spectra[1].valid.where(waves, True).all())


@pytest.mark.slow
def test_lines_in_which_large_moving_holes_may_show_are_not_valid():
    sea = Sea(seed=70600, highest=3.5, shape=(160, 70, 90), waves=200, depth=0.7, slope=6)
    cube, missing = sea.cube(("z", "z_t", "u", "v", "w")), np.zeros(sea.shape, bool)
    for first, step in (((5, 70), (1.3, -0.9)), ((50, 20), (-0.7, 1.6))):
        for t in range(sea.shape[0]):
            y, x = (int(a + b * t) % (n - 8) for a, b, n in zip(first, step, sea.shape[1:]))
            missing[t, y : y + 8, x : x + 8] = True
    holed = cube.where(~xr.DataArray(missing, dims=cube.z.dims))
    whole, found = (wv.E_omega(wv.komega(c.z, segment=80)) for c in (cube, holed))
    ratio = found.E / whole.E
    assert float(ratio.where(found.frequency > 4).max()) > 5
    assert float(ratio.where(found.valid & (found.frequency > 1)).max()) < 2
    assert bool(found.valid.where((found.frequency > 1.2) & (found.frequency < 3), True).all())
    analysed = wv.analyze(holed, segment=80)
    beyond = analysed["spectra"].frequency > 4.5
    assert not bool(analysed["spectra"].valid_Ez.sel(source="stereo").where(beyond, False).any())
    assert "less than four times that are not valid" in analysed.attrs["notes"]
