"""Drives a page in headless Chromium: reads its models, clicks in data coordinates, collects its errors."""

import shutil
from pathlib import Path

import numpy as np

FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
)
_NAMED = "Bokeh.documents[0].get_model_by_name"


def chromium() -> str | None:
    """Return the path of Chromium on this machine."""
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    return next((path for name in names if (path := shutil.which(name))), None)


class Browser:
    """A page, and the errors and warnings that it logged."""

    def __init__(self, page) -> None:
        self.page = page
        self.errors: list[str] = []
        self.outside: list[str] = []
        page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda r: self._requested(r.url))
        page.on("websocket", lambda socket: self._requested(socket.url))

    def _requested(self, url: str) -> None:
        here = (
            "http://localhost:",
            "http://127.0.0.1:",
            "ws://localhost:",
            "ws://127.0.0.1:",
            "data:",
            "blob:",
        )
        if not url.startswith(here):
            self.outside.append(url)

    def open(self, url: str, ready: str = "map_image") -> None:
        """Go to an address and wait for the first picture."""
        self.page.goto(url)
        self.wait(f"Object.values({_NAMED}('{ready}').data)[0].length")
        self.page.locator(".bk-Canvas").first.wait_for()

    def wait(self, condition: str) -> None:
        """Wait until a JavaScript expression is true; an error in it counts as false."""
        code = f"() => {{ try {{ return {condition} }} catch (error) {{ return false }} }}"
        self.page.wait_for_function(code, timeout=60_000)

    def get(self, name: str, what: str):
        """Return a property of a model, such as "value" or "data.x"."""
        return self.page.evaluate(f"{_NAMED}('{name}').{what}")

    def set(self, name: str, what: str, value: str) -> None:
        """Set a property of a model to a JavaScript value."""
        self.page.evaluate(f"() => {{ {_NAMED}('{name}').{what} = {value} }}")

    def column(self, name: str, column: str) -> np.ndarray:
        """Return a column of a data source."""
        return np.array(self.page.evaluate(f"Array.from({_NAMED}('{name}').data['{column}'])"), float)

    def image(self, name: str) -> np.ndarray:
        """Return the picture in an image's data source, (ny, nx)."""
        code = f"(() => {{ const a = {_NAMED}('{name}').data.image[0]; return [a.shape, Array.from(a)] }})()"
        shape, values = self.page.evaluate(code)
        return np.array([np.nan if v is None else v for v in values], float).reshape(shape)

    def at(self, figure: str, x: float, y: float) -> tuple[float, float]:
        """Return the position on the screen of a point of a figure."""
        code = f"""(() => {{
          const v = Bokeh.index.find_one({_NAMED}('{figure}'))
          const r = v.el.getBoundingClientRect()
          return [r.x + v.frame.x_scale.compute({x}), r.y + v.frame.y_scale.compute({y})]
        }})()"""
        px, py = self.page.evaluate(code)
        return float(px), float(py)

    def click(self, figure: str, x: float, y: float) -> None:
        """Click a point of a figure."""
        self.page.mouse.click(*self.at(figure, x, y))

    def drag(self, figure: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag from one point of a figure to another."""
        a, b = self.at(figure, *start), self.at(figure, *end)
        self.page.mouse.move(*a)
        self.page.mouse.down()
        for part in (0.3, 0.6, 1.0):
            self.page.mouse.move(a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]))
        self.page.mouse.up()

    def screenshot(self, path: Path) -> None:
        """Save a screenshot."""
        self.page.screenshot(path=str(path), full_page=True)
