"""Write durations, ranges of numbers and small tables for people, in the same form everywhere."""

import math
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path


def spell_time(seconds: float) -> str:
    """Return a duration as text, such as "8 s", "3 min 05 s" or "2 h 10 min"."""
    if 0 < seconds < 0.95:
        return f"{seconds:.1g} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def spell_ranges(numbers: Sequence[int], most: int = 8) -> str:
    """Return sorted integers as text with ranges, such as "1-3, 7".
    At most `most` ranges are listed; the text ends with the number of ranges left out."""
    ranges: list[list[int]] = []
    for number in numbers:
        if ranges and number == ranges[-1][1] + 1:
            ranges[-1][1] = number
        else:
            ranges.append([number, number])
    words = [str(a) if a == b else f"{a}-{b}" for a, b in ranges[:most]]
    return ", ".join(words) + (f" and {len(ranges) - most} more ranges" if len(ranges) > most else "")


def spell_uncertain(value: float, std: float, unit: str) -> str:
    """Return a value and its standard uncertainty as text, such as "0.37926 +- 0.00015 m".
    The uncertainty has two significant digits or no decimals, and the value as many decimals. If the
    uncertainty is not finite, the text is the value alone, with two decimals."""
    if not math.isfinite(std):
        return f"{value:.2f} {unit}"
    digits = max(1 - math.floor(math.log10(std)), 0) if std > 0 else 2
    return f"{value:.{digits}f} +- {std:.{digits}f} {unit}"


def short_path(path: Path) -> Path:
    """Return a path relative to the current folder if it lies in this folder, else unchanged."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def one_line(error: object) -> str:
    """Return the message of an exception in one line: line breaks and runs of spaces become one space."""
    return " ".join(str(error).split())


def html_table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as HTML text for notebooks, with a `title`, a header row (`head`) and rows of cells.
    If `head` is empty, there is no header row."""
    lines = [("th", head), *(("td", row) for row in rows)]
    text = "".join(
        "<tr>" + "".join(f"<{kind}>{escape(str(cell))}</{kind}>" for cell in line) + "</tr>"
        for kind, line in lines
        if line
    )
    return f"<b>{escape(title)}</b><table>{text}</table>"


def full_stop(words: str) -> str:
    """Return a text with a full stop at its end, unless it ends with ".", "?" or "!"."""
    return words if words.endswith((".", "?", "!")) else f"{words}."
