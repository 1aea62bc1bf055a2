"""A page that compares the runs of a catalog (a list of experiments), with links to their reports."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import xarray as xr
from markupsafe import Markup

from wavefield.atomic_write import Product, identity_of, write_text
from wavefield.pipeline import open_run
from wavefield.reports.html import Head, ReportSection, Table, render
from wavefield.reports.numbers import with_interval
from wavefield.store import beside
from wavefield.store.ledger import status

# group and variable of the wave store, heading, factor to the displayed unit
_COLUMNS = (
    ("statistics", "significant_height", "Hs, cm", 100.0),
    ("statistics", "peak_frequency", "peak, Hz", 1.0),
    ("statistics", "steepness", "steepness k_p σ", 1.0),
    ("kinematics", "nonlinear_fraction", "nonlinear fraction of w", 1.0),
)
_CAPTION = "A dash: not measured, not analysed, or the record is too short"


def compare(title: str, cubes: Sequence[tuple[str, Path]], output: str | Path) -> Path:
    """Write the page that compares the runs of a catalog, and return its path, `output`.
    `cubes` holds the name of each run and the path of its cube, which need not exist."""
    output = Path(output)
    groups = {run: _groups(cube) for run, cube in cubes if cube.is_dir()}
    head = ("run", "verdict", "steps", *(heading for _, _, heading, _ in _COLUMNS), "report")
    rows = [_row(run, cube, groups.get(run), output) for run, cube in cubes]
    sections = [ReportSection("The runs", [Table(_CAPTION, head, rows)])]
    lines = (f"{len(groups)} of {len(cubes)} runs measured",)
    write_text(output, render(Head(title, lines), sections), Product("campaign page", identity_of(title)))
    return output


def _groups(cube: Path) -> dict[str, xr.Dataset]:
    """Return the groups "statistics" and "kinematics" of a cube's wave store, by name, if they exist."""
    run, names = open_run(cube), ("statistics", "kinematics")
    return {name: group for name in names if (group := run.wave_group(name)) is not None}


def _row(run: str, cube: Path, groups: Mapping[str, xr.Dataset] | None, output: Path) -> list[str]:
    if groups is None:
        return [run, "not run yet", *["–"] * (len(_COLUMNS) + 2)]
    state, verdict = status(cube), "not finished"
    if state.complete:
        verdict = state.verdict.line if state.verdict else "none yet: run it once more"
    values = [with_interval(groups.get(group), name, factor) or "–" for group, name, _, factor in _COLUMNS]
    report, link = beside(cube, "report", ".html"), "–"
    if report.exists():
        path = Path(os.path.relpath(report, output.absolute().parent)).as_posix()
        link = Markup('<a href="{}">report</a>').format(path)
    return [run, verdict, f"{state.steps - state.left} of {state.steps}", *values, link]
