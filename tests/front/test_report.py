"""The report: one file without external content, and every picture with a text alternative."""

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from wavefield.pipeline import Run
from wavefield.reports.compose import builders_of, head_of, write_report
from wavefield.reports.fields import at_probe, pack
from wavefield.reports.html import render
from wavefield.reports.numbers import RunNumbers
from wavefield.reports.result import facts
from wavefield.tank import paper_rig
from wavefield.variables import CUBE_FIELDS, Quality


def run_of(cube, **parts):
    """Return the run of a cube in memory, with only the given waves and files."""
    run = Run(cube, *(Path("nowhere") / name for name in ("cube.zarr", "experiment.yaml")))
    vars(run).update({"pair_statistics": None} | parts)
    return run


class Page(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.text = [], [], {}
        self.feed(text)
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append((tag, attrs))
        if tag not in {"meta", "link", "img", "input"}:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def all(self, tag):
        return [attrs for name, attrs in self.tags if name == tag]


@pytest.fixture(scope="module")
def page_text(cube, tmp_path_factory):
    cube = cube.assign_attrs(recipe=json.dumps({"settings": {}}))
    run = run_of(cube, rig=paper_rig(), truth=0.98 * cube)
    path = write_report(run, tmp_path_factory.mktemp("report") / "report.html")
    return path.read_text(encoding="utf-8")


def test_a_light_sheet_has_no_surface_and_no_waves_in_its_report(cube):
    settings = {"sheet_thickness": 0.001}
    run = run_of(cube.assign_attrs(recipe=json.dumps({"settings": settings})), rig=paper_rig())
    names = [name for name, *_ in facts(RunNumbers(run))]
    assert names[:2] == ["Rms of the velocity u, v, w", "Coverage"]
    surface = run_of(cube.assign_attrs(recipe=json.dumps({"settings": {}})), rig=paper_rig())
    assert len(builders_of(run, None)) == len(builders_of(surface, None)) - 4
    assert "water surface" not in head_of(run, None).title


def test_nothing_comes_from_a_network(page_text):
    page = Page(page_text)
    loaded = [a.get("src") or a.get("href") for t, a in page.tags if t in {"img", "script", "link", "iframe"}]
    assert all(url is None or url.startswith("data:") for url in loaded)
    without_data = re.sub(r"[A-Za-z0-9+/=]{200,}", "", page_text)
    assert not re.search(r"https?://|@import|fetch\(|XMLHttpRequest|url\(", without_data)


def test_page_is_small_and_each_picture_is_a_png_with_words(page_text):
    assert len(page_text) < 3e6
    pictures = Page(page_text).all("img")
    assert len(pictures) >= 8
    assert len({picture["src"] for picture in pictures}) == len(pictures)
    for picture in pictures:
        assert len(picture["alt"]) > 15
        raw = base64.b64decode(picture["src"].removeprefix("data:image/png;base64,"))
        assert raw[:4] == b"\x89PNG"


def test_sections_links_and_controls(page_text):
    page = Page(page_text)
    anchors = {a["id"] for t, a in page.tags if t == "section"}
    links = {a["href"][1:] for a in page.all("a")} - {"main"}
    assert links == anchors
    controls = {a["id"] for t, a in page.tags if t in {"input", "select", "output"}}
    labelled = {a["for"] for a in page.all("label")}
    assert controls - {"clock"} <= labelled
    for canvas in page.all("canvas"):
        assert canvas["role"] == "img"
        assert canvas["aria-label"]


def test_numbers_of_the_summary_are_those_of_the_cube(page_text, cube):
    assert f"{100 * float(cube.z.std()):.3g} cm" in page_text
    assert "1 done with faults" in page_text
    assert "along paths of 6 frames" in page_text


def test_the_result_comes_first_then_what_needs_attention_and_the_rest_is_folded(cube, page_text):
    page = Page(page_text)
    sections = [a for t, a in page.tags if t == "section"]
    assert [a["id"] for a in sections[:2]] == ["result", "what-needs-attention"]
    assert all(a.get("class") == "folded" for a in sections[3:])
    first = page_text.split('id="what-needs-attention"')[0].split('<dl class="facts">')[1]
    measured = ((cube.quality & int(Quality.MEASURED)) != 0).mean()
    for value in (
        ", ".join(f"{100 * float(np.sqrt((cube[n].astype(float) ** 2).mean())):.3g}" for n in "uvw"),
        f"{100 * float(measured):.3g} %",
        f"{1e3 * float(cube.z_std.median()):.2g} mm",
        f"{cube.sizes['time']} steps at 20 Hz",
    ):
        assert value in first
    for name in ("Significant wave height Hs", "Peak period"):  # both come with an uncertainty, or not at all
        assert f"{name}</dt><dd><strong>–</strong> <span>no waves yet: run" in first


def test_height_and_period_have_their_uncertainty_or_a_reason(cube):
    found = {"significant_height": 0.05, "significant_height_std": 0.004, "peak_frequency": 1.25}

    def rows(**more):
        run = run_of(cube, wave_group=lambda name: xr.Dataset(found | more), waves=xr.Dataset())
        return [(value, note) for _, value, note in facts(RunNumbers(run))[:2]]

    assert rows(peak_frequency_std=0.02) == [("5 ± 0.4 cm", ""), ("0.8 ± 0.013 s", "")]
    assert rows()[1] == ("–", "the record is too short to state it with its uncertainty")


def test_probes_are_compared_with_the_elevation_at_their_places(cube, tmp_path, undrawn):
    x, y = 0.5 * float(cube.x[3] + cube.x[4]), float(cube.y[7])
    exact = cube.z.interp(x=x, y=y).values
    clock = np.linspace(float(cube.time[0]), float(cube.time[-1]), 2 * cube.sizes["time"] - 1)
    series = np.interp(clock, cube.time, exact) + 0.02
    probes = xr.Dataset(
        {"elevation": (("probe", "time"), [series, series])},
        {"time": clock, "probe": ["p1", "far"]}
        | {"probe_x": ("probe", [x, 9.0]), "probe_y": ("probe", [y, 0.0])},
    )
    found = at_probe(cube, probes.isel(probe=0))
    assert float(found.rms_difference) < 1e-6
    text = write_report(run_of(cube, probes=probes), tmp_path / "p.html").read_text(encoding="utf-8")
    assert "Elevation and wave probes" in text
    assert "p1: rms difference" in text
    assert re.search(r"far</th><td[^>]*>outside the grid, at x 9 m, y 0 m<", text)
    placeless = probes.isel(probe=0).assign_coords(probe_x=np.nan)
    assert "does not give its position" in at_probe(cube, placeless)


def test_what_is_missing_is_reported(cube, tmp_path, undrawn):
    text = write_report(run_of(cube), tmp_path / "bare.html").read_text(encoding="utf-8")
    assert "Not in this report: spectra and coherence (no waves yet: run <code>wavefield analyze" in text
    assert "Pairs of cameras are not compared: " in text
    assert '<section id="spectra"' not in text


def test_text_from_outside_is_escaped(cube, tmp_path, undrawn):
    run = run_of(cube.assign_attrs(experiment="<script>alert(1)</script>"))
    text = write_report(run, tmp_path / "bad.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text


def test_the_verdict_with_description_and_date_stands_first(cube, tmp_path):
    from wavefield.series import Experiment
    from wavefield.store.verdict import Remark, Verdict

    experiment = Experiment.model_construct(description="Waves of a paddle, 12 cm of water", mask={})
    run = replace(run_of(cube), store=tmp_path)
    vars(run).update(experiment=experiment, frames={})
    verdict = Verdict([Remark("cam1", "focus", "grave", "its images are blurred")])
    found = render(head_of(run, verdict), []).split("<header>")[1]
    words = [
        found.index(w)
        for w in ("Verdict: not to be trusted: cam1 focus", "Waves of a paddle", "This page made 20")
    ]
    assert words == sorted(words)
    assert 'class="verdict bad"' in found


def test_no_folder_of_this_machine_is_reported(cube, tmp_path, undrawn):
    attrs = {"experiment_file": "/home/somebody/tank/experiment.yaml"}
    recipe = json.dumps({"images": {"cam1": "/home/somebody/tank/cam1/*.tif"}, "settings": {}})
    run = replace(
        run_of(cube.assign_attrs(attrs | {"recipe": recipe})), store=Path("/home/somebody/tank/cube.zarr")
    )
    vars(run)["pair_statistics"] = None
    text = write_report(run, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "/home/" not in text
    assert "wavefield analyze cube.zarr" in text
    assert "experiment.yaml" in text


@pytest.mark.slow
def test_a_long_cube_is_thinned_to_fit(cube):
    wide = xr.concat([cube] * 4, "time").isel(x=np.arange(120) % 44, y=np.arange(90) % 36)
    wide = wide.assign_coords(x=0.01 * np.arange(120), y=0.01 * np.arange(90), time=np.arange(192) / 20)
    assert sum(wide[name].size for name in CUBE_FIELDS) > 20e6
    assert sum(map(len, pack(wide.chunk(time=48)).values())) < 3e6
