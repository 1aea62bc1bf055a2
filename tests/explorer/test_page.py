"""The page without a browser: built for any cube, at any place; it goes on when something is amiss."""

import re
import time
from collections import Counter

import numpy as np
import pytest
from bokeh.core.validation import check_integrity
from bokeh.document import Document
from explorer_cases import create_cube, make_cube, write_cube_block

from wavefield.explorer.look_page import LookPage
from wavefield.explorer.place import TABS, Place
from wavefield.explorer.server import middle_node
from wavefield.explorer.session import LookSession
from wavefield.explorer.whole_record import request_of
from wavefield.store.verdict import Remark, Verdict


def build(path, place=None):
    session = LookSession(path)
    session.record.preview.load()
    page, document = LookPage(session, place or Place()), Document()
    page.attach(document)
    return page, document


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "cube.zarr"
    make_cube(path)
    return path


def test_a_page_without_faults_prints_nothing_in_the_terminal(cube):
    found = check_integrity(list(build(cube)[1].models))
    assert (found.error, found.warning) == ([], [])


def test_every_variable_and_view_can_be_shown(cube):
    page, document = build(cube)
    for k, name in enumerate(page.session.record.names):
        for tab in ("surface", TABS[k % len(TABS)]):  # what the others show is the same for every variable
            page.change(show=name, tab=tab)
            page.redraw()
        assert page.panels.map.figure.title.text.startswith(f"{name}: ")
    document.to_json()


def test_models_have_different_names(cube):
    _, document = build(cube)
    names = Counter(model.name for model in document.models if model.name)
    assert [name for name, count in names.items() if count > 1] == []


def test_a_place_is_shown_at_once(cube):
    place = Place("z", 17, node=(0.1, 0.1), line=(-0.2, 0, 0.2, 0), area=(-0.1, -0.1, 0.1, 0.1))
    page, _ = build(cube, place)
    assert page.controls["step"].value == 17
    assert page.controls.link.text == place.query()
    assert len(page.panels.map.sources["node"].data["x"]) == 1


def test_it_opens_at_the_measured_node_nearest_to_the_middle(cube):
    record = LookSession(cube).record
    x, y = middle_node(record, 0)
    assert abs(x - record.x.mean()) <= 0.026
    assert abs(y - record.y.mean()) <= 0.026
    record._cache["z", 0] = np.full((16, 20), np.nan, np.float32)
    record._cache["z", 0][3, 4] = 0.0
    assert middle_node(record, 0) == (record.x[4], record.y[3])


def test_the_head_shows_the_significant_height_and_the_verdict(cube, tmp_path):
    path = tmp_path / "cube.zarr"
    fields = make_cube(path)
    focus = Remark("cam1", "focus", "remark", "its <images> are blurred")
    Verdict.of([focus]).save(path)
    page, _ = build(path)
    height = float(re.search(r"Hs ([\d.]+) cm", page.header.state.text)[1])
    assert height == pytest.approx(400 * np.nanstd(fields["z"]), rel=0.01)
    assert "sound with remarks" in page.header.verdict.text
    assert "cam1: its &lt;images&gt; are blurred" in page.header.verdict.text


@pytest.mark.parametrize("average", ["mean", "rms"])
def test_a_mean_over_time_is_shown_with_its_own_colours(cube, average):
    page, _ = build(cube)
    wait_for = page.averages
    page.change(show="w", average=average)
    page.redraw()
    for _ in range(200):
        if wait_for.get(request_of(page.session.record, page.place), None) is not None:
            break
        time.sleep(0.02)
    page.redraw()
    values = np.array([page.session.record.field("w", k) for k in range(120)])
    shown = page.panels.map.sources["image"].data["image"][0]
    expected = values.mean(axis=0) if average == "mean" else values.std(axis=0)
    np.testing.assert_allclose(shown, 100 * expected, atol=2e-3)
    assert page.panels.map.figure.title.text.endswith(f"{average} over time")
    assert (page.panels.map.mapper.low == 0) == (average == "rms")
    page.change(show="quality")
    page.redraw()
    assert "t = " in page.panels.map.figure.title.text


def test_phase_averages_need_a_period_and_are_shown_at_the_phase_of_the_step(cube):
    page, _ = build(cube)
    page.change(show="z", average="phase", step=3)
    page.redraw()
    assert page.controls["period"].visible
    assert "enter the period of the waves" in page.panels.map.figure.title.text
    page.change(period=0.8)
    page.redraw()
    for _ in range(200):
        if page.averages.get(request_of(page.session.record, page.place), None) is not None:
            break
        time.sleep(0.02)
    page.redraw()
    assert re.search(r"phase average over 0\.8 s, phase \d+°", page.panels.map.figure.title.text)
    assert Place.read({"average": "phase", "period": "0.8"}).period == 0.8
    assert Place.read({"period": "-1"}).period is None
    page.change(average="mean")
    page.redraw()
    assert not page.controls["period"].visible


def test_logarithmic_colours_are_those_of_magnitudes(cube):
    page, _ = build(cube)
    page.change(show="w", log=True, colours="viridis")
    page.redraw()
    w = 100 * np.abs(page.session.record.field("w", 0))
    shown = page.panels.map.sources["image"].data["image"][0]
    np.testing.assert_allclose(10 ** shown[5:], w[5:], rtol=1e-4)
    assert page.panels.map.mapper.palette[0].lower() == "#440154"
    assert page.panels.map.hover.tooltips[0] == ("|w|", "@image{custom} cm/s")
    page.change(log=False)
    page.redraw()
    assert page.panels.map.hover.tooltips[0] == ("w", "@image{custom} cm/s")


def test_fitted_colours_are_nobodys_wish(cube):
    page, _ = build(cube)
    page.redraw()
    assert page.place.limits is None
    page.controls["low"].value, page.controls["high"].value = -3.0, 4.0
    assert page.place.limits == (-3.0, 4.0)


def test_a_damaged_step_is_a_sentence_and_the_others_are_shown(cube, tmp_path):
    path = tmp_path / "cube.zarr"
    make_cube(path)
    next((path / "w" / "c").glob("0/0/0")).write_bytes(b"nonsense")
    page, document = LookPage(LookSession(path), Place(step=1)), Document()
    page.attach(document)
    assert "w of steps 0 to 39 is lost" in page.header.state.text
    page.change(step=50)
    page.redraw()
    assert np.isfinite(page.panels.map.sources["image"].data["image"][0]).any()


def test_an_empty_cube_is_shown_as_such(tmp_path):
    path = tmp_path / "cube.zarr"
    create_cube(path)
    page, _ = build(path, Place(node=(0.0, 0.0), tab="surface"))
    assert "not measured yet" in page.panels.map.figure.title.text
    assert "measured so far: 0 (0 %)" in page.header.state.text
    write_cube_block(path, 0)
    page.recheck()
    assert "measured so far: 40" in page.header.state.text


def test_what_is_missing_beside_a_cube_is_a_sentence(cube):
    page, _ = build(cube)
    assert "no waves yet" in page.session.run.reason("waves")
    assert "no images" in page.panels.cameras().words.text
