"""The page without a browser: any cube in any state; drawings are compared with numpy."""

import re
import shutil
from collections import Counter

import numpy as np
import pytest
import xarray as xr
from bokeh.core.validation import check_integrity
from bokeh.document import Document
from explorer_cases import create_cube, make_cube, write_cube_block
from scipy import signal

from wavefield.errors import WavefieldError
from wavefield.explorer.node import nearest_probe, spectrum
from wavefield.explorer.page import LookPage
from wavefield.explorer.parts import TABS, Place
from wavefield.explorer.record import LookSession
from wavefield.explorer.server import make_server
from wavefield.explorer.waves import log_density
from wavefield.pipeline.analysis import analyze
from wavefield.store.verdict import Remark, Verdict

DT = 0.05


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


def test_every_variable_and_view_can_be_shown_and_models_have_different_names(cube):
    page, document = build(cube)
    found = check_integrity(list(document.models))  # what Bokeh would print in the terminal
    assert (found.error, found.warning) == ([], [])
    for k, name in enumerate(page.session.record.names):
        page.change(show=name, tab=TABS[k % len(TABS)])
        page.redraw()
        assert page.map.layout.title.text.startswith(f"{name}: ")
    document.to_json()
    names = Counter(model.name for model in document.models if model.name)
    assert [name for name, count in names.items() if count > 1] == []


def test_a_place_is_shown_at_once_and_counted_from_one(cube):
    page, _ = build(cube, Place("z", 17, node=(0.1, 0.1)))
    assert page.controls["step"].value == 17
    assert page.controls["step"].title == "Step 18 of 120, t = 0.875 s"
    assert page.link.text == page.place.query()
    assert len(page.map.sources["node"].data["x"]) == 1


def test_a_node_shows_its_values_series_and_spectrum(tmp_path):
    fields = make_cube(tmp_path / "cube.zarr")
    page, _ = build(tmp_path / "cube.zarr", Place(step=7, node=(0.175, 0.125)))  # column 13, row 10
    page._show_picked()
    w, std = 100 * fields["w"][:, 10, 13], 100 * fields["w_std"][:, 10, 13]
    drawn = page.node.sources["w_series"].data
    np.testing.assert_allclose(drawn["value"], w, atol=6e-3)
    np.testing.assert_allclose(0.5 * (drawn["high"] - drawn["low"]), std, rtol=0.02)
    reading = re.search(r"w ([\d.\u2212]+) ± ([\d.]+) cm/s", page.node.words.text)
    assert float(reading[1].replace("\u2212", "-")) == pytest.approx(w[7], rel=0.01)
    density = spectrum(100 * fields["z"][:, 10, 13].astype(float), DT).density
    np.testing.assert_allclose(page.node.sources["spectrum"].data["e"], density, rtol=0.05)
    assert page.node.spectrum.title.text.endswith(" times the curve")


def test_the_head_gives_the_verdict_with_its_remarks(tmp_path):
    path = tmp_path / "cube.zarr"
    make_cube(path)
    Verdict([Remark("cam1", "focus", "remark", "its <images> are blurred")]).save(path)
    page, _ = build(path)
    assert "sound with remarks" in page.verdict.text
    assert "cam1: its &lt;images&gt; are blurred" in page.verdict.text


def test_a_damaged_step_is_a_sentence_and_the_others_are_shown(tmp_path):
    path = tmp_path / "cube.zarr"
    make_cube(path)
    next((path / "w" / "c").glob("0/0/0")).write_bytes(b"nonsense")
    page, document = LookPage(LookSession(path), Place(step=1)), Document()
    page.attach(document)
    assert "cube.zarr/w is damaged" in page.state.text
    page.change(step=50)
    page.redraw()
    assert np.isfinite(page.map.sources["image"].data["image"][0]).any()


def test_an_empty_cube_is_shown_as_such(tmp_path):
    path = tmp_path / "cube.zarr"
    create_cube(path)
    page, _ = build(path, Place(node=(0.0, 0.0)))
    page._show_picked()
    assert "not measured yet" in page.map.layout.title.text
    assert "measured so far: 0 (0 %)" in page.state.text
    assert page.node.spectrum.title.text.startswith("No spectrum: it needs 32 steps")
    write_cube_block(path, 0)
    page.recheck()
    assert "measured so far: 40" in page.state.text


def test_what_is_missing_beside_a_cube_is_a_sentence(cube):
    page, _ = build(cube)
    assert page.waves.body.children[0].text.endswith("Loading …</span>")
    page.change(tab="waves")
    page.redraw()
    assert "no waves yet" in page.waves().words.text
    assert "no images" in page.cameras().words.text


def test_the_waves_of_the_analysis_are_shown_and_those_of_another_cube_refused(tmp_path):
    for name, steps in (("cube", 120), ("other", 80)):
        make_cube(tmp_path / name / "cube.zarr", steps=steps)
    waves = analyze(tmp_path / "cube" / "cube.zarr", tmp_path / "cube" / "waves.zarr")
    page, _ = build(tmp_path / "cube" / "cube.zarr", Place(tab="waves"))
    energy = waves["spectra"]["E"].sel(quantity="w").transpose("omega", "k").values
    drawn = page.waves().sources["image"].data["image"][0]
    np.testing.assert_allclose(drawn, log_density(energy), atol=1e-5)
    shutil.copytree(tmp_path / "cube" / "waves.zarr", tmp_path / "other" / "waves.zarr")
    other, _ = build(tmp_path / "other" / "cube.zarr", Place(tab="waves"))
    assert "the waves of another cube" in other.waves().words.text


def test_probes_are_marked_and_only_one_at_the_node_is_drawn_over_it(cube):
    page, _ = build(cube, Place(node=(0.125, 0.125)))
    at = {"probe_x": ("probe", [0.12, 0.3, 9.0]), "probe_y": ("probe", [0.1, 0.1, 0.0])}
    time = np.arange(0, 6, 0.02)
    probes = xr.Dataset(
        {"elevation": (("time", "probe"), 0.01 * np.sin(7 * time)[:, None] * np.ones(3))},
        {"time": time, "probe": ["here", "there", "far"]} | at,
    )
    page._show_probes(probes)
    page._show_picked()
    assert page.map.sources["probes"].data["name"] == ["here", "there"]
    assert page.map.sources["probes"].data["align"] == ["right", "right"]  # inwards
    assert page.trouble == "probes outside the map: far"
    assert "Dashed: here, " in page.node.words.text
    assert np.abs(page.node.sources["probe_series"].data["value"]).max() == pytest.approx(1.0, rel=0.01)
    page.pick(-0.3, 0.1)
    page._show_picked()
    assert len(page.node.sources["probe_series"].data["t"]) == 0
    assert nearest_probe(probes, 0.2, 0.1, 0.05) is None


# -- what is drawn -----------------------------------------------------------------------------------------


def test_spectra_are_those_of_scipy_and_their_intervals_hold_the_truth():
    rng = np.random.default_rng(5)
    inside = []
    for _ in range(60):
        found = spectrum(rng.normal(size=2048), DT)
        part = found.density[3:-3]
        inside.append(np.mean((part * found.low < 2 * DT) & (2 * DT < part * found.high)))
    assert 0.93 < np.mean(inside) < 0.97
    values = rng.normal(size=333)
    found = spectrum(values, DT)
    _, density = signal.welch(values, fs=1 / DT, nperseg=round(1 / (found.frequency[0] * DT)))
    np.testing.assert_allclose(found.density, density[1:], rtol=1e-10)
    assert spectrum(np.full(50, np.nan), DT) is None


# -- links -------------------------------------------------------------------------------------------------


def test_a_link_shows_the_same_place_again():
    place = Place("eps_piv", 77, "waves", (-2.5, 2.5), "nothing", (0.1, -0.25))
    query = dict(pair.split("=") for pair in place.query().split("&"))
    assert Place.read(query, ("w", "eps_piv"), 100) == place
    assert Place.read({"step": "5000"}, ("w",), 100).step == 99


@pytest.mark.parametrize(
    "query",
    [
        {"show": "nonsense"}, {"step": "1e5"}, {"node": "1,2,3"}, {"node": "a,b"}, {"node": "nan,0"},
        {"limits": "3,1"}, {"tab": "<script>"}, {"unknown": "1"}, {"line": "0,0,1,1"},
    ],
)  # fmt: skip
def test_links_that_make_no_sense_show_the_usual_place(query):
    assert Place.read(query, ("w", "z"), 100, 4) == Place(step=4)


def test_a_port_that_is_taken_is_a_sentence():
    first = make_server(lambda document: None, 0)
    try:
        with pytest.raises(WavefieldError, match=rf"port {first.port} is taken; choose another with --port"):
            make_server(lambda document: None, first.port)
    finally:
        first.stop()
