"""Fill the tables of docs/validation.md from the results of benchmarks: `python docs/make_validation.py`."""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.results import RESULTS, Result

PAGE = Path(__file__).with_name("validation.md")
PLACE = re.compile(r"(<!-- result: (\S+) -->\n).*?(<!-- end -->)", re.S)


def filled(page: str) -> str:
    """The page with every table made anew from its file."""
    return PLACE.sub(
        lambda place: f"{place[1]}{Result.load(RESULTS / f'{place[2]}.yaml').markdown()}\n{place[3]}", page
    )


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
