"""One HTML page that needs nothing else: figures, tables and text put together."""

import base64
import html
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from string import Template

from matplotlib.figure import Figure

from wavefield import __version__

_DPI = 140  # drawn at 96 per inch: sharp on dense screens, and small
_WIDE = 1150  # px: a PNG so wide holds several panels; on a phone it is moved sideways, not made small
_SENTENCE = 60  # letters: a cell with more is read, not looked up


def marked_up(words: str) -> str:
    """Plain words as HTML; what stands between backticks is to be typed.

    Examples
    --------
    >>> marked_up("name <them> as `rest:`")
    'name &lt;them&gt; as <code>rest:</code>'
    """
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(words))


@dataclass(frozen=True)
class Picture:
    """A figure with what it shows in words."""

    figure: Figure | bytes  # A matplotlib figure, or a PNG file as bytes
    caption: str  # Below the figure: what it is and how to read it
    alt: str  # For those who cannot see it: what one would see, with its numbers

    def html(self) -> str:
        """Give the picture as HTML with its data inside."""
        width = ""
        if isinstance(self.figure, bytes):
            raw = self.figure
        else:
            buffer = io.BytesIO()
            self.figure.savefig(buffer, format="png", dpi=_DPI)
            raw = buffer.getvalue()
            width = f'width="{round(96 * self.figure.get_figwidth())}" '
        many = ' class="wide"' if _width_of(raw) >= _WIDE else ""
        return (
            f'<figure{many}><img src="data:image/png;base64,{base64.b64encode(raw).decode()}" {width}'
            f'alt="{html.escape(self.alt)}"><figcaption>{html.escape(self.caption)}</figcaption></figure>'
        )


def _width_of(png: bytes) -> int:
    """Width of a PNG, px."""
    return int.from_bytes(png[16:20], "big")


@dataclass(frozen=True)
class Table:
    """Rows of text under a heading row."""

    caption: str  # What it lists
    head: Sequence[str]  # Column names
    rows: Sequence[Sequence[str]]  # Cells; the first of each row names it

    def html(self) -> str:
        """Give the table as HTML."""
        told = " told" if any(len(cell) > _SENTENCE for row in self.rows for cell in row) else ""
        head = "".join(f'<th scope="col">{html.escape(cell)}</th>' for cell in self.head)
        body = "".join(
            f'<tr><th scope="row">{html.escape(row[0])}</th>'
            + "".join(
                f'<td data-of="{html.escape(name)}">{marked_up(cell)}</td>'
                for name, cell in zip(self.head[1:], row[1:], strict=True)
            )
            + "</tr>"
            for row in self.rows
        )
        return (
            f'<div class="table{told}" tabindex="0"><table><caption>{html.escape(self.caption)}</caption>'
            f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
        )


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    words: str  # Plain text

    def html(self) -> str:
        """Give the paragraph as HTML."""
        return f"<p>{marked_up(self.words)}</p>"


@dataclass(frozen=True)
class Listing:
    """Something long that is folded away: a recipe, a list of faults."""

    title: str  # What one clicks on
    words: str  # Plain text, shown as it is

    def html(self) -> str:
        """Give the listing as HTML."""
        title, words = html.escape(self.title), html.escape(self.words)
        return f"<details><summary>{title}</summary><pre>{words}</pre></details>"


@dataclass(frozen=True)
class Markup:
    """HTML made by this package itself."""

    markup: str  # HTML

    def html(self) -> str:
        """Give it back."""
        return self.markup


@dataclass
class ReportSection:
    """A part of the page."""

    title: str  # Heading
    # Pictures, tables, texts, in order
    items: list[Picture | Table | Text | Listing | Markup] = field(default_factory=list)

    @property
    def anchor(self) -> str:
        """Name for links inside the page."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower())

    def html(self) -> str:
        """Give the section as HTML."""
        return (
            f'<section id="{self.anchor}"><h2>{html.escape(self.title)}</h2>'
            + "\n".join(item.html() for item in self.items)
            + "</section>"
        )


@dataclass(frozen=True)
class Head:
    """What a page says first."""

    title: str  # Of the page
    lines: Sequence[str] = ()  # What it is about, a paragraph each; empty ones are left out
    verdict: str = ""  # Whether it can be trusted, in one line; none if empty
    weight: str = "note"  # Of the verdict: its colour and its sign

    def html(self) -> str:
        """Give the head as HTML."""
        sign, state = _VERDICTS[self.weight]
        verdict = (
            f'<p class="verdict {state}"><span aria-hidden="true">{sign}</span> '
            f"<strong>Verdict: {html.escape(self.verdict)}</strong></p>"
            if self.verdict
            else ""
        )
        lines = "".join(f"<p>{html.escape(line)}</p>" for line in self.lines if line)
        return f"<h1>{html.escape(self.title)}</h1>{verdict}{lines}"


_VERDICTS = {"note": ("\u2714", "good"), "remark": ("!", "doubtful"), "grave": ("\u2716", "bad")}


def render(head: Head, sections: Sequence[tuple[ReportSection, str]], player: Mapping[str, str]) -> str:
    """Put the page together.

    With sections (Section, str).
    """
    assets = files("wavefield.reports").joinpath("assets")
    return Template(assets.joinpath("page.html").read_text(encoding="utf-8")).substitute(
        title=html.escape(head.title),
        head=head.html(),
        style=assets.joinpath("page.css").read_text(encoding="utf-8"),
        script=assets.joinpath("player.js").read_text(encoding="utf-8") if player else "",
        data="".join(
            f'<script type="application/octet-stream" id="{name}">{value}</script>'
            for name, value in player.items()
        ),
        contents="".join(f'<li><a href="#{s.anchor}">{html.escape(s.title)}</a></li>' for s, _ in sections),
        body="\n".join(body for _, body in sections),
        version=html.escape(__version__),
    )
