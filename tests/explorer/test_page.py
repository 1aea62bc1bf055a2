"""The page without a browser: built for any cube, at any place; it goes on when something is amiss."""

from collections import Counter

import numpy as np
import pytest
from bokeh.core.validation import check_integrity
from bokeh.document import Document
from explorer_cases import create_cube, make_cube, write_cube_block

from wavefield.explorer.look_page import LookPage
from wavefield.explorer.place import TABS, Place
from wavefield.explorer.session import LookSession


def build(path, place=None):
    session = LookSession.open(path)
    session.record.preview.load()
    page, document = LookPage(session, place or Place()), Document()
    page.attach(document)
    return page, document


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "cube.zarr"
    make_cube(path)
    return path


def test_the_terminal_is_told_of_nothing_amiss_in_a_page(cube):
    found = check_integrity(list(build(cube)[1].models))
    assert (found.error, found.warning) == ([], [])


def test_every_variable_and_view_can_be_shown(cube):
    page, document = build(cube)
    for name in page.session.record.names:
        for tab in TABS:
            page.change(show=name, tab=tab)
            page.redraw()
        assert page.panels.map.figure.title.text.startswith(f"{name}: ")
    document.to_json()


def test_models_can_be_told_apart_by_name(cube):
    _, document = build(cube)
    names = Counter(model.name for model in document.models if model.name)
    assert [name for name, count in names.items() if count > 1] == []


def test_a_place_is_shown_at_once(cube):
    place = Place("z", 17, node=(0.1, 0.1), line=(-0.2, 0, 0.2, 0), area=(-0.1, -0.1, 0.1, 0.1))
    page, _ = build(cube, place)
    assert page.controls.step.value == 17
    assert page.controls.link.text == place.query()
    assert len(page.panels.map.sources["node"].data["x"]) == 1


def test_fitted_colours_are_nobodys_wish(cube):
    page, _ = build(cube)
    page.redraw()
    assert page.place.limits is None
    page.controls.low.value, page.controls.high.value = -3.0, 4.0
    assert page.place.limits == (-3.0, 4.0)


def test_a_damaged_step_is_a_sentence_and_the_others_are_shown(cube, tmp_path):
    path = tmp_path / "cube.zarr"
    make_cube(path)
    next((path / "w" / "c").glob("0/0/0")).write_bytes(b"nonsense")
    page, document = LookPage(LookSession.open(path), Place(step=1)), Document()
    page.attach(document)
    assert "w of steps 0 to 39 is lost" in page.state.text
    page.change(step=50)
    page.redraw()
    assert np.isfinite(page.panels.map.sources["image"].data["image"][0]).any()


def test_an_empty_cube_is_shown_as_such(tmp_path):
    path = tmp_path / "cube.zarr"
    create_cube(path)
    page, _ = build(path, Place(node=(0.0, 0.0), tab="surface"))
    assert "not measured yet" in page.panels.map.figure.title.text
    assert "measured so far: 0 (0 %)" in page.state.text
    write_cube_block(path, 0)
    page.recheck()
    assert "measured so far: 40" in page.state.text


def test_what_is_missing_beside_a_cube_is_a_sentence(cube):
    page, _ = build(cube)
    assert "no waves yet" in page.session.run.reason("waves")
    assert "no images" in page.panels.cameras.words.text
