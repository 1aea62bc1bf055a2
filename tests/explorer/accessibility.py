"""Accessibility faults of a page, found by axe-core: names, contrast, language, headings."""

from importlib.resources import files

import pytest


def accessibility_faults(window) -> list[str]:
    """Return the serious and critical accessibility faults of the page in a Playwright window."""
    pytest.importorskip("axe_playwright_python", reason="needs axe-core: pip install axe-playwright-python")
    window.evaluate(files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8"))
    found = window.evaluate("() => axe.run()")["violations"]
    serious = [one for one in found if one["impact"] in ("serious", "critical")]
    return [f"{one['id']}: {one['nodes'][0]['html'][:120]}" for one in serious]
