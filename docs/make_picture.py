"""Photograph the head of a demo's report for the README: `python docs/make_picture.py wavefield-demo`.

Needs the extra `browser` and Chromium.
"""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

PICTURE = Path(__file__).with_name("report.jpg")
WIDTH, HEIGHT = 1260, 770  # px: verdict, first map and key numbers


def main(demo: Path) -> None:
    """Write the picture of the report in a demo's folder."""
    page_address = (demo / "report.html").absolute().as_uri()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        page.goto(page_address)
        page.wait_for_timeout(2000)  # the map is drawn by a script
        page.screenshot(path=PICTURE, type="jpeg", quality=88)
        browser.close()
    print(f"wrote {PICTURE}, {PICTURE.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "wavefield-demo"))
