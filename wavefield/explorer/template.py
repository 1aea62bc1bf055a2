"""The frame of a page: one template, one style sheet, one script, all from this package."""

from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from bokeh.events import ConnectionLost
from bokeh.models import CustomJS
from jinja2 import Environment

_KEYS = (
    ("\u2190 \u2192", "step"), ("space", "play"), ("1\u20134", "views"),
    ("P L R M", "move, line, rectangle, mask"), ("A", "arrows"), ("Home End", "first, last step"),
)  # fmt: skip


@cache
def asset(name: str) -> str:
    """A file of the package's assets."""
    return files("wavefield.explorer").joinpath(f"assets/{name}").read_text(encoding="utf-8")


def dress(document: Any, heading: str, command: str, places: Sequence[str], keys: bool = True) -> None:
    """Give a document its frame."""
    words = "".join(f" <kbd>{key}</kbd> {what}" for key, what in _KEYS) if keys else ""
    document.title = f"{heading} \u2013 wavefield {command}"
    document.template = Environment(autoescape=False).from_string(asset("page.html"))
    document.template_variables.update(
        heading=heading.replace("&", "&amp;").replace("<", "&lt;"),
        command=command,
        places=list(places),
        css=asset("page.css"),
        script=asset("page.js"),
        footer=f'<span class="keys">Keys:{words}</span>' if keys else "",
    )
    document.js_on_event(ConnectionLost, CustomJS(code='document.getElementById("lost").hidden = false'))
