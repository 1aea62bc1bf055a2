"""Builds an HTML page that needs no other file, from figures, tables and text in a Jinja template."""

import base64
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field
from functools import cache
from importlib.resources import files
from typing import Literal

from jinja2 import Environment, PackageLoader
from markupsafe import Markup, escape
from matplotlib.figure import Figure
from PIL import Image

from wavefield import __version__
from wavefield.figures.style import file_of
from wavefield.store.verdict import Remark
from wavefield.text import full_stop

_DPI = 120  # at which two panels of 5.2 inches fill the width of the page
_COLOURS = 128  # colours of the palette; a third of the bytes without a visible difference
WIDE_PX = 1000  # a wider picture has several panels and takes a row of its own


class Item:
    """Base class of what a section of a page can contain: pictures, tables, texts, ..."""

    @property
    def kind(self) -> str:
        """Class name in lower case, by which the template chooses the markup."""
        return type(self).__name__.lower()


@dataclass
class Picture(Item):
    """A picture in a page, made from a figure or from the bytes of a PNG file."""

    figure: InitVar[Figure | bytes]
    caption: str  # text below the picture: what it shows and how to read it
    alt: str  # content of the picture with its numbers, for readers who cannot see it
    png: bytes = field(init=False)

    def __post_init__(self, figure: Figure | bytes) -> None:
        if isinstance(figure, Figure):
            figure = file_of(figure, dpi=_DPI, pil_kwargs={"compress_level": 1})
        self.png = small_png(figure)

    @property
    def data(self) -> str:
        """The PNG file in base 64, as text."""
        return base64.b64encode(self.png).decode()

    @property
    def wide(self) -> bool:
        """Whether the picture needs the full width of the page."""
        return int.from_bytes(self.png[16:20], "big") >= WIDE_PX  # the width in the header of a PNG


def small_png(png: bytes) -> bytes:
    """Return the PNG file `png` with its colours reduced to 128, or the file itself if that is smaller."""
    image = Image.open(io.BytesIO(png)).convert("RGB")
    buffer = io.BytesIO()
    image.quantize(_COLOURS, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return min(png, buffer.getvalue(), key=len)


@dataclass(frozen=True)
class Table(Item):
    """A table of text with a heading row."""

    caption: str
    head: Sequence[str]  # names of the columns
    rows: Sequence[Sequence[str]]  # cells; the first of each row names it


@dataclass(frozen=True)
class Text(Item):
    """A paragraph of plain text."""

    words: str


@dataclass(frozen=True)
class Facts(Item):
    """The main results, each with its name, its value and a note in small print."""

    rows: Sequence[tuple[str, str, str]]


@dataclass(frozen=True)
class Remarks(Item):
    """Remarks of the verdict on a cube, each with what was found, what it means and what to do."""

    remarks: Sequence[Remark]


@dataclass(frozen=True)
class Player(Item):
    """An animation of the surface. The reader moves it to another time with a slider."""

    data: Mapping[str, str]  # result of `pack`, for the script
    still: Picture  # the surface at one moment, for readers without scripts


@dataclass
class ReportSection:
    """A section of a page, with a title and items; `render` leaves it out if it has no items."""

    title: str
    items: list[Item] = field(default_factory=list)
    folded: bool = False  # whether its content is hidden until the title is clicked
    gist: str = ""  # one line that sums up a folded section, next to its title
    # "result": the first item is wide, the second narrow; "beside": as many items in a row as fit
    layout: Literal["", "result", "beside"] = ""

    @property
    def anchor(self) -> str:
        """Name of the section in links inside the page."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower())


@dataclass(frozen=True)
class Head:
    """The top of a page: title, lines of text, and the verdict on a cube or a rig."""

    title: str
    lines: Sequence[str] = ()  # paragraphs; empty ones are left out
    verdict: str = ""  # one line on whether the results can be used; empty without a verdict
    weight: str = "note"  # of the verdict: "note", "remark" or "grave"; sets its colour and sign


def with_code(words: str) -> Markup:
    """Return plain text as HTML, with the text between backticks as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(words))))


def capital(words: str) -> str:
    """Return a sentence with a capital first letter, unless it begins with the name of a variable."""
    return words if words.startswith(("z ", "u ", "v ", "w ")) else words[:1].upper() + words[1:]


def _asset(name: str) -> Markup:
    return Markup(files("wavefield.reports").joinpath("assets", name).read_text(encoding="utf-8"))


@cache
def _environment() -> Environment:
    loader = PackageLoader("wavefield.reports", "assets")
    made = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    made.filters |= {"with_code": with_code, "capital": capital, "full_stop": full_stop}
    made.globals |= {"asset": _asset, "version": __version__}
    return made


def render(head: Head, sections: Sequence[ReportSection]) -> str:
    """Return the HTML of a page with a head and sections; sections without items are left out."""
    sections = [section for section in sections if section.items]
    return _environment().get_template("page.html").render(head=head, sections=sections)
