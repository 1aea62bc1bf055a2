"""Words that the project has replaced by terms of the field do not come back."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("wavefield", "tests", "docs", "benchmarks", "notebooks", "workflows", "catalogs")
PAGES = ("README.md", "CONTRIBUTING.md")
TEXT = {".py", ".pyi", ".md", ".yaml", ".ipynb", ".txt", ".html", ".js"}
# word: what is written instead
REPLACED = {
    r"witness(es)?": "patch matching, patch matcher",
    r"suspects?": "camera faults",
    r"judgement": "verdict",
    r"steadied|steadiness": "stabilized, camera motion",
    r"trembl(es?|ing)": "jitter",
    r"who_lies|liars?": "outlier camera",
    r"sought": "searched, elevation model",
    r"afloat": "on the water",
    r"undisturbed": "deferred signals, still",
    r"believed": "measured, shrinkage",
    r"look_again": "reevaluate",
    r"likeness": "correlation",
    r"told": "usable, separated, stated",
    r"wants|wanted": "needs, requested",
    r"mends?|mended|mending": "correct, repair",
    r"tells|told_apart": "reports, shows",
    r"says|said": "states, reports, prints",
    r"knows": "holds, has",
    r"looked": "searched, examined",
}  # fmt: skip


def texts():
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            if (
                path.suffix in TEXT
                and path != Path(__file__)
                and not {"_build", "wavefield-demo"} & set(path.parts)
            ):
                yield path
    yield from (ROOT / page for page in PAGES)


@pytest.mark.parametrize("word", REPLACED, ids=lambda word: word.split("|")[0])
def test_replaced_words_do_not_come_back(word):
    pattern = re.compile(rf"(?<![a-z])({word})(?![a-z])", re.I)  # words of snake_case as well
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()[:90]}"
        for path in texts()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if pattern.search(line)
    ]
    assert not found, f"write {REPLACED[word]} instead:\n" + "\n".join(found)
