"""The report and the calibration page in a browser: on a screen, a phone, in dark mode, printed."""

import base64
import re

import cv2
import numpy as np
import pytest
from accessibility import accessibility_faults

from wavefield.figures.style import panels
from wavefield.reports import report
from wavefield.reports.calibration import calibration_page


@pytest.fixture(scope="module")
def report_page(whole, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    return report(whole[0], path)


@pytest.fixture(scope="module")
def rig_page(tmp_path_factory):
    pixels = {"rms_px": 0.004, "rms_mm": 0.006, "max_px": 0.02}
    content = {
        "usable": True, "problems": [], "sentences": ["On the water a pixel is 1.5 mm."],
        "notes": ["cam1: its lens is held"], "model": "f k1",
        "cameras": {n: pixels | {"position_m": [x, 0.0, 3.2], "views": {"flat": {"points": 90}}}
                    for n, x in (("cam1", -3.0), ("cam2", 3.1))},
        "predicted": {"reprojection_px": dict.fromkeys(("cam1", "cam2"), 3e-4), "z_mm": 6e-4,
                      "image_covered": dict.fromkeys(("cam1", "cam2"), 0.98)},
        "epipolar": {"cam1 - cam2": {"points": 90, "rms_px": 0.006, "median_px": 0.004, "max_px": 0.02}},
        "parameters": {n: {"fx_px": [2917.0, 0.06]} for n in ("cam1", "cam2")},
    }  # fmt: skip
    path = tmp_path_factory.mktemp("rig") / "index.html"
    drawn = [("rig", "The rig", panels(1)[0]), ("residuals", "Residuals of cam1", panels(2)[0])]
    path.write_text(calibration_page(content, drawn), encoding="utf-8")
    return path


def opened(chrome, path, width=1400, height=900, **how):
    window = chrome.new_context(viewport={"width": width, "height": height}, **how).new_page()
    errors = []
    window.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    window.on("pageerror", lambda error: errors.append(str(error)))
    window.goto(path.as_uri())
    if "report" in path.name:
        window.locator("#map").wait_for(state="visible")
    assert errors == []
    window.errors = errors
    return window


def bottom(window, what):
    return window.locator(what).last.evaluate("one => one.getBoundingClientRect().bottom + scrollY")


def test_the_result_is_on_the_first_screen_and_the_page_has_at_most_eight(chrome, report_page):
    window = opened(chrome, report_page)
    assert report_page.stat().st_size < 3e6
    assert window.evaluate("document.documentElement.scrollHeight") <= 8 * 900
    for what in (".verdict, h1", "#map", "#relief", ".facts div", "#what-needs-attention h2"):
        assert bottom(window, what) <= 900
    names = window.locator(".facts dt").all_inner_texts()
    assert [re.sub(r"[ ,].*", "", name) for name in names[:4]] == ["Significant", "Peak", "Rms", "Coverage"]
    pictures = window.evaluate("[...document.images].map((one) => one.src)")
    assert len(set(pictures)) == len(pictures) >= 15
    assert window.locator("table:visible tr").count() <= 24


def test_the_surface_moves_with_the_slider_in_the_colours_of_w(chrome, report_page, whole):
    window = opened(chrome, report_page)
    assert not window.locator("#still img").is_visible()
    drawn = "() => ['map', 'relief'].map((id) => document.getElementById(id).toDataURL())"
    before = window.evaluate(drawn)
    window.locator("#moment").press("ArrowRight")
    after = window.evaluate(drawn)
    assert all(one != other for one, other in zip(before, after))
    step = int(window.locator("#moment").input_value())
    first = (whole[1]["w"].shape[0] - int(window.locator("#moment").get_attribute("max")) - 1) // 2
    w = whole[1]["w"][first + step]
    png = base64.b64decode(after[0].partition(",")[2])
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).astype(int)  # blue, green, red
    nodes = np.argwhere(np.isfinite(w) & (np.abs(w) > 0.5 * np.nanmax(np.abs(w))))
    right = [np.sign(_redness(image, w.shape, *node)) == np.sign(w[tuple(node)]) for node in nodes]
    assert len(right) > 20
    assert np.mean(right) > 0.95


def test_maps_of_every_shape_are_drawn(chrome, report_page):
    window = opened(chrome, report_page)
    for width in range(560, 720, 7):
        window.evaluate("(width) => { document.getElementById('map').width = width }", width)
        window.locator("#moment").press("ArrowRight")
    assert window.errors == []


def _redness(image, shape, j, i):
    """Return red minus blue of the map at a node, without its arrow; uses the margins of player.js."""
    (left, top, right, bottom), (high, wide) = (84, 54, 118, 74), image.shape[:2]
    cell = min((wide - left - right) / shape[1], (high - top - bottom) / shape[0])
    y = round((high + top - bottom + shape[0] * cell) / 2 - (j + 0.5) * cell)
    x = round(left + (i + 0.5) * cell)
    patch = image[y - 7 : y + 8, x - 7 : x + 8].reshape(-1, 3)
    patch = patch[patch.max(-1) > 60]
    return np.median(patch[:, 2] - patch[:, 0])


def test_folded_parts_open_by_a_link_by_the_button_and_for_printing(chrome, report_page):
    window = opened(chrome, report_page)
    parts, unfold = window.locator("section.folded > details"), window.locator("#unfold")
    opened_parts = "() => document.querySelectorAll('section.folded > details[open]').length"
    assert window.evaluate(opened_parts) == 0
    window.locator("nav a", has_text="Accuracy").click()
    window.wait_for_function("() => document.querySelector('#accuracy details').open")
    assert window.evaluate(opened_parts) == 1
    window.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert window.evaluate(opened_parts) == parts.count()
    window.evaluate("dispatchEvent(new Event('afterprint'))")
    assert window.evaluate(opened_parts) == 1
    unfold.click()
    window.wait_for_function("() => document.getElementById('unfold').textContent == 'Fold all'")
    assert window.evaluate(opened_parts) == parts.count()


@pytest.mark.parametrize(
    "how", [{}, {"color_scheme": "dark"}, {"width": 390, "height": 800}], ids=["screen", "dark", "phone"]
)
def test_every_reader_can_use_the_pages(chrome, report_page, rig_page, how):
    for path in (report_page, rig_page):
        window = opened(chrome, path, **how)
        assert window.evaluate("document.documentElement.scrollWidth") <= how.get("width", 1400)
        assert accessibility_faults(window) == []
        window.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        assert accessibility_faults(window) == []


def test_without_scripts_the_surface_is_a_picture_and_all_parts_can_be_unfolded(chrome, report_page):
    window = chrome.new_context(java_script_enabled=False).new_page()
    window.goto(report_page.as_uri())
    assert window.locator("#still img").is_visible()
    assert not window.locator("#map").is_visible()
    window.locator("#recipe summary").first.click()
    assert window.locator("#recipe table").is_visible()


def test_the_calibration_page_begins_with_one_sentence(chrome, rig_page):
    window = opened(chrome, rig_page)
    assert window.locator("header p:not(.verdict)").inner_text() == "On the water a pixel is 1.5 mm."
    assert "cam1: its lens is held" in window.locator("#what-needs-attention").inner_text()


@pytest.mark.parametrize(
    ("style", "fault"),
    [
        ("figcaption { color: #aaa }", "color-contrast"),
        ("", ""),
    ],
)
def test_faults_of_a_page_are_found(chrome, rig_page, style, fault):
    window = opened(chrome, rig_page)
    window.add_style_tag(content=style or "p { }")
    found = accessibility_faults(window)
    assert any(one.startswith(fault) for one in found) if fault else found == []
