"""Fill the tables of README.md and docs/validation.md from benchmarks/results.

Run `python docs/make_validation.py`. Between `<!-- result: NAME -->` and `<!-- end -->` goes the table of
benchmarks/results/NAME.json; with `NAME, rows: A; B` only the rows whose first cell begins with A or B, with
`NAME, first: N` the first N rows of each first cell.
"""

import re
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.results import RESULTS, Result

PAGES = (Path(__file__).parents[1] / "README.md", Path(__file__).with_name("validation.md"))
PLACE = re.compile(r"(<!-- result: (\w+)(?:, (rows|first): ([^>]+))? -->\n).*?(<!-- end -->)", re.S)


def table(name: str, choice: str | None, given: str | None) -> str:
    """A stored result as a Markdown table: all rows, those that begin with given texts, or the first ones."""
    result = Result.load(RESULTS / f"{name}.json")
    if choice == "first" and given:
        kinds = [row[0] for row in result.rows]
        chosen = [row for n, row in enumerate(result.rows) if kinds[:n].count(row[0]) < int(given)]
        result = replace(result, rows=chosen)
    elif given:
        wanted = [text.strip() for text in given.split(";")]
        rows = [next(row for row in result.rows if row[0].startswith(text)) for text in wanted]
        result = replace(result, rows=rows)
    return result.markdown()


def filled(page: str) -> str:
    """The page with every table made anew from its file."""
    return PLACE.sub(lambda place: f"{place[1]}{table(*place.group(2, 3, 4))}\n{place[5]}", page)


if __name__ == "__main__":
    for path in PAGES:
        path.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")
