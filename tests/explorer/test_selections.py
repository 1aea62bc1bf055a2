"""What nodes, lines and rectangles show, against plain numpy."""

import numpy as np
import pytest

from wavefield.explorer import selections
from wavefield.explorer.map_fields import arrows
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import envelope, image_data
from wavefield.figures.display import display
from wavefield.figures.quality_kinds import KINDS, quality_kind

DT = 0.05


def stored(values, scale=1e-4):
    return np.where(np.isfinite(values), np.rint(values / scale), -32768).astype(np.int16)


def test_the_spectrum_of_a_sine_holds_its_variance_at_its_frequency():
    t = DT * np.arange(4096)
    values = 0.02 * np.sin(2 * np.pi * 2.5 * t) + 0.3
    found = selections.spectrum(values, DT)
    step = found.frequency[1] - found.frequency[0]
    assert found.density.sum() * step == pytest.approx(0.02**2 / 2, rel=1e-3)
    assert found.frequency[found.density.argmax()] == pytest.approx(2.5, abs=step)


def test_the_interval_of_a_spectrum_holds_the_truth_as_often_as_stated():
    rng = np.random.default_rng(5)
    inside = []
    for _ in range(60):
        found = selections.spectrum(rng.normal(size=2048), DT)
        truth = 2 * DT
        part = found.density[3:-3]
        inside.append(np.mean((part * found.low < truth) & (truth < part * found.high)))
    assert 0.93 < np.mean(inside) < 0.97


def test_gaps_are_bridged_up_to_two_steps_and_split_the_record_beyond():
    values = np.sin(np.arange(100) / 5.0)
    holed = values.copy()
    holed[[20, 21, 60, 61, 62]] = np.nan
    run = selections.longest_run(holed)
    assert run.size == 60
    np.testing.assert_allclose(np.delete(run, [20, 21]), np.delete(values[:60], [20, 21]))
    assert selections.spectrum(np.full(50, np.nan), DT) is None


def test_a_plane_is_interpolated_exactly_and_nothing_is_given_outside():
    x, y = np.linspace(-1, 1, 11), np.linspace(-0.5, 0.5, 7)
    field = 3.0 + 2.0 * x[None, :] - 4.0 * y[:, None]
    distance, px, py = selections.line_points((-0.9, -0.4), (1.4, 0.45), 0.1)
    values = selections.interpolate(field, x, y, px, py)
    inside = px <= 1.0
    np.testing.assert_allclose(values[inside], (3.0 + 2.0 * px - 4.0 * py)[inside])
    assert np.isnan(values[~inside]).all()
    assert distance[-1] == pytest.approx(np.hypot(2.3, 0.85))


def test_the_time_distance_diagram_is_the_transect_of_every_step():
    rng = np.random.default_rng(1)
    x, y = np.linspace(0, 1, 9), np.linspace(0, 0.6, 6)
    values = rng.normal(size=(6, 9, 30))
    _, px, py = selections.line_points((0.05, 0.1), (0.8, 0.45), 0.05)
    diagram = selections.time_distance(stored(values), 1e-4, x, y, px, py)
    for step in (0, 13, 29):
        expected = selections.interpolate(values[..., step], x, y, px, py)
        np.testing.assert_allclose(diagram[step], expected, atol=1e-4)


def test_a_rectangle_has_the_means_and_the_histogram_of_its_values():
    rng = np.random.default_rng(2)
    values = rng.normal(0.01, 0.05, size=(5, 4, 400))
    values[0, 0, 7] = np.nan
    values[:, :, 9] = np.nan
    found = selections.area(stored(values), 1e-4, DT)
    with np.errstate(invalid="ignore"):
        flat = values.reshape(20, -1)
        mean = np.array([c[np.isfinite(c)].mean() if np.isfinite(c).any() else np.nan for c in flat.T])
        std = np.array([c[np.isfinite(c)].std() if np.isfinite(c).any() else np.nan for c in flat.T])
    np.testing.assert_allclose(found.mean, mean, atol=6e-5)
    np.testing.assert_allclose(found.std, std, atol=6e-5)
    assert found.count == np.isfinite(values).sum()
    assert (found.density * np.diff(found.edges)).sum() == pytest.approx(1.0)
    counts, _ = np.histogram(np.rint(values[np.isfinite(values)] / 1e-4) * 1e-4, found.edges)
    np.testing.assert_allclose(found.density * found.count * np.diff(found.edges), counts)


def test_an_envelope_keeps_extremes_gaps_and_ends():
    rng = np.random.default_rng(3)
    x, y = np.arange(12000.0), rng.normal(size=12000)
    y[5000:6000] = np.nan
    thin_x, thin_y, other = envelope(x, y, 2 * y)
    assert thin_x.size <= 1000
    assert np.nanmax(thin_y) == np.nanmax(y)
    assert np.nanmin(thin_y) == np.nanmin(y)
    assert np.isnan(thin_y[(thin_x > 5050) & (thin_x < 5950)]).all()
    np.testing.assert_array_equal(other, 2 * thin_y)
    assert np.all(np.diff(thin_x) > 0)


def test_the_gravest_bit_names_a_node():
    names = [k[1] for k in KINDS]
    assert names[quality_kind(np.array(1 | 64))] == "measured"
    assert names[quality_kind(np.array(2 | 16))] == "rejected: mismatch"
    assert names[quality_kind(np.array(4))] == "outside the view"
    assert quality_kind(np.array(0)) == len(KINDS)


def test_arrows_point_where_the_water_goes_and_are_as_long_as_it_is_fast():
    x, y = np.linspace(0, 1, 25), np.linspace(0, 1, 25)
    u, v = np.full((25, 25), 0.3), np.full((25, 25), -0.4)
    u[3, 4] = np.nan
    xs, ys, metres = arrows(u, v, x, y, 0.5)
    xs, ys = xs.reshape(-1, 7), ys.reshape(-1, 7)
    assert len(xs) == 25 * 25 - 1
    np.testing.assert_allclose(xs[:, 1] - xs[:, 0], 0.3 * metres)
    np.testing.assert_allclose(ys[:, 1] - ys[:, 0], -0.4 * metres)
    assert np.isnan(np.concatenate([xs[:, 6], ys[:, 6]])).all()  # no line from arrow to arrow
    assert metres * 0.5 == pytest.approx(1.2 / 24)


def test_colours_are_balanced_where_there_is_a_sign():
    values = np.linspace(-1, 3, 1000)
    low, high = display("w").limits(values)
    assert low == -high
    assert display("z_std").limits(np.abs(values))[0] == 0.0
    assert display("z_std").limits(np.linspace(0.9, 1.0, 50)) == (0.9, 1.0)  # a map of more than one colour
    assert display("z_std").limits(np.full(50, 0.9)) == (0.0, 0.9)


def test_images_are_centred_on_their_nodes():
    data = image_data(np.zeros((3, 5)), np.linspace(-1, 1, 5), np.linspace(0, 1, 3))
    assert (data["x"], data["dw"]) == ([-1.25], [2.5])
    assert (data["y"], data["dh"]) == ([-0.25], [1.5])


def test_a_link_shows_the_same_place_again():
    place = Place(
        show="eps_piv",
        step=77,
        tab="waves",
        limits=(-2.5, 2.5),
        average="phase",
        period=0.8,
        colours="viridis",
        log=True,
        overlay="streamlines",
        node=(0.1, -0.25),
        line=(0, 0, 1, 0.5),
        area=(-1, -1, 1, 1),
    )
    query = dict(pair.split("=") for pair in place.query().split("&"))
    assert Place.read(query, ("w", "eps_piv"), 100) == place


@pytest.mark.parametrize(
    "query",
    [
        {"show": "nonsense"},
        {"step": "1e5"},
        {"node": "1,2,3"},
        {"node": "a,b"},
        {"limits": "3,1"},
        {"tab": "<script>"},
        {"line": "nan,0,0,0"},
        {"unknown": "1"},
    ],
)
def test_links_that_make_no_sense_show_the_usual_place(query):
    assert Place.read(query, ("w", "z"), 100, 4) == Place(step=4)


def test_a_step_beyond_the_end_is_the_last():
    assert Place.read({"step": "5000"}, ("w",), 100).step == 99
