"""How quickly the page of a long cube answers, in headless Chromium, figure by figure.

    python -m benchmarks.explorer [--folder DIR] [--steps 12000] [--nodes 150 200]

The cube holds one block of waves again and again (its files are linked), which reads as any other.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "explorer"))

from browser import FLAGS, Browser, chromium
from explorer_cases import create_cube, write_cube_block

from wavefield.store.preview import preview_path

_BLOCK = 100


def long_cube(path: Path, steps: int, shape: tuple[int, int]) -> None:
    """A cube of so many steps, every block the same."""
    if path.exists():
        return
    layout = create_cube(path, steps=steps, ny=shape[0], nx=shape[1], block=_BLOCK)
    write_cube_block(path, 0)
    for root in (path, preview_path(path)):
        for first in [p for p in root.rglob("*") if p.is_file() and p.parent != root and "c" in p.parts]:
            parts = list(first.relative_to(root).parts)
            if "c" not in parts or parts[0] in ("time", "x", "y", "frame"):
                continue
            at = len(parts) - 1 if parts[0] == "fields" else parts.index("c") + 1
            for block in range(1, len(layout.chunks())):
                other = root.joinpath(*parts[:at], str(block), *parts[at + 1 :])
                other.parent.mkdir(parents=True, exist_ok=True)
                os.link(first, other)


def timed(action: Callable[[], None], done: Callable[[], None]) -> float:
    """Seconds from an action to its picture."""
    start = time.perf_counter()
    action()
    done()
    return time.perf_counter() - start


def derived(window: Browser, paint: Callable[[], None]) -> tuple[Callable[[], None], Callable[[], None]]:
    """Asking for a series that is worked out, and waiting for it."""
    named = "Bokeh.documents[0].get_model_by_name"

    def ask() -> None:
        window.page.evaluate(f"() => {{ window._o = {named}('node_other_series').data }}")
        window.set("node_other", "value", "'vorticity'")

    def there() -> None:
        window.wait(
            f"{named}('node_other_figure').left[0].axis_label.startsWith('vorticity') && "
            f"{named}('node_other_series').data !== window._o && "
            f"isFinite({named}('node_other_series').data.value[500])"
        )
        paint()

    return ask, there


def measure(url: str, window: Browser, steps: int) -> dict[str, float]:
    """The issue's figures, seconds."""
    named = "Bokeh.documents[0].get_model_by_name"
    painted = "() => new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(() => r(true))))"
    out: dict[str, float] = {}

    def paint() -> None:
        window.page.evaluate(painted)

    def first() -> None:
        window.open(url)

    out["first map"] = timed(first, paint)
    window.wait(f"!{named}('state_words').text.includes('reading the preview')")
    stepped = []
    for k in range(12):
        step = int(steps * (k + 0.5) / 12)

        def go(step: int = step) -> None:
            window.set("step", "value", str(step))

        def there(step: int = step) -> None:
            window.wait(f"{named}('map').title.text.includes('t = {(step + 0.5) / 20:.3f} s')")
            paint()

        stepped.append(timed(go, there))
    out["a step, anywhere"] = statistics.median(stepped)
    following = []
    for k in range(10):
        step = steps // 2 + k

        def on(step: int = step) -> None:
            window.set("step", "value", str(step))

        def seen(step: int = step) -> None:
            window.wait(f"{named}('map').title.text.includes('t = {(step + 0.5) / 20:.3f} s')")
            paint()

        following.append(timed(on, seen))
    out["the next step"] = statistics.median(following)
    clicked = []
    for k in range(8):
        x = 0.05 * (k - 4)

        def click(x: float = x) -> None:
            window.page.evaluate(f"() => {{ window._t = {named}('node_w_series').data }}")
            window.click("map", x, 0.1)

        def series() -> None:
            window.wait(
                f"{named}('node_w_series').data !== window._t && {named}('node_w_series').data.t.length > 500"
            )
            paint()

        clicked.append(timed(click, series))
        window.page.wait_for_timeout(400)
    out["a click's series"] = statistics.median(clicked[1:])
    out["its vorticity, from the cube itself"] = timed(*derived(window, paint))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "wavefield_explorer")
    parser.add_argument("--steps", type=int, default=12_000)
    parser.add_argument("--nodes", type=int, nargs=2, default=(150, 200), metavar=("NY", "NX"))
    arguments = parser.parse_args()
    path = (
        arguments.folder / f"long_{arguments.steps}_{arguments.nodes[0]}_{arguments.nodes[1]}" / "cube.zarr"
    )
    long_cube(path, arguments.steps, tuple(arguments.nodes))

    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "wavefield.commands.cli", "look", str(path), "--port", "0", "--no-open"]
    start = time.perf_counter()
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    url = next(line for line in server.stdout if "http://" in line).split()[1]
    begun = time.perf_counter() - start
    try:
        with sync_playwright() as started:
            browser = started.chromium.launch(executable_path=chromium(), args=FLAGS.split())
            window = Browser(browser.new_page(viewport={"width": 1400, "height": 900}))
            rows = {"the command, until it serves": begun} | measure(url, window, arguments.steps)
            again = Browser(browser.new_page(viewport={"width": 1400, "height": 900}))
            rows["first map of a second person"] = timed(lambda: again.open(url), lambda: None)
            complaints = len(window.errors) + len(again.errors), len(window.outside) + len(again.outside)
            browser.close()
    finally:
        server.terminate()
        server.wait()
    print(f"{arguments.steps} x {arguments.nodes[0]} x {arguments.nodes[1]}, load {os.getloadavg()[0]:.1f}")
    for name, seconds in rows.items():
        print(f"  {name:32} {1000 * seconds:8.0f} ms")
    print(f"  console errors {complaints[0]}, requests outside the loopback {complaints[1]}")
    print(f"  arrays of numpy {np.__version__}")


if __name__ == "__main__":
    main()
