"""The report and the calibration page as a reader has them: on a screen, a phone, in the dark, on paper."""

import re
from importlib.resources import files

import pytest

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
        "models_compared": [],
        "cameras": {n: pixels | {"position_m": [x, 0.0, 3.2], "views": {"flat": {"points": 90}}}
                    for n, x in (("cam1", -3.0), ("cam2", 3.1))},
        "predicted": {"reprojection_px": dict.fromkeys(("cam1", "cam2"), 3e-4), "z_mm": 6e-4,
                      "z_of_which_tilt_mm": 5e-4, "image_covered": dict.fromkeys(("cam1", "cam2"), 0.98),
                      "strongest_correlations": []},
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


def accessibility_faults(window):
    """What axe-core calls serious or critical."""
    package = pytest.importorskip(
        "axe_playwright_python", reason="needs axe-playwright-python (extra browser)"
    )
    window.evaluate(files(package).joinpath("axe.min.js").read_text(encoding="utf-8"))
    found = window.evaluate("() => axe.run()")["violations"]
    serious = [one for one in found if one["impact"] in ("serious", "critical")]
    return [f"{one['id']}: {one['nodes'][0]['html'][:120]}" for one in serious]


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


def test_the_surface_moves_with_the_slider(chrome, report_page):
    window = opened(chrome, report_page)
    assert not window.locator("#still img").is_visible()
    drawn = "() => ['map', 'relief'].map((id) => document.getElementById(id).toDataURL())"
    before = window.evaluate(drawn)
    window.locator("#moment").press("ArrowRight")
    after = window.evaluate(drawn)
    assert all(one != other for one, other in zip(before, after))


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
