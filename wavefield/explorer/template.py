"""The frame of a page: one template, one style sheet, one script, all from this package."""

from collections.abc import Sequence
from functools import cache
from importlib.resources import files

from bokeh.document import Document
from bokeh.events import ConnectionLost
from bokeh.models import CustomJS
from jinja2 import Environment

_KEYS = (
    ("← →", "step"), ("space", "play"), ("1–4", "views"), ("P L R M", "pan, line, rectangle, mask"),
    ("A", "overlay"), ("Home End", "first, last step"),
)  # fmt: skip


@cache
def asset(name: str) -> str:
    """A file of the package's assets."""
    return files("wavefield.explorer").joinpath(f"assets/{name}").read_text(encoding="utf-8")


def apply_template(
    document: Document,
    heading: str,
    command: str,
    places: Sequence[str],
    keys: bool = True,
    aspect: float = 1.3,
) -> None:
    """Give a document its frame: the roots named in `places` below a heading, with the list of the keys.
    The views are as wide as a map of an aspect (width to height) can be without reaching below the window.
    """
    document.title = f"{heading} – wavefield {command}"
    document.template = Environment(autoescape=True).from_string(asset("page.html"))
    document.template_variables.update(
        heading=heading, command=command, places=list(places), css=asset("page.css"), script=asset("page.js"),
        keys=_KEYS if keys else (), aspect=f"{aspect:.4f}",
    )  # fmt: skip
    document.js_on_event(ConnectionLost, CustomJS(code='document.getElementById("lost").hidden = false'))
