"""One page that compares the runs of a campaign, with links to the report of each."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure

from wavefield.atomic_write import PAGE, write_text
from wavefield.figures.style import LINES, RIGHT, frequency_axis, panels, plain_axes
from wavefield.pipeline import open_run
from wavefield.reports.html_page import Head, Picture, ReportSection, Table, render
from wavefield.reports.number_text import number
from wavefield.store.ledger import status
from wavefield.store.store_paths import beside

MAX_SPECTRA = 12  # in the picture
# group, variable, heading, factor
_COLUMNS = (
    ("statistics", "significant_height", "Hs, cm", 100.0),
    ("statistics", "peak_frequency", "peak, Hz", 1.0),
    ("statistics", "steepness", "steepness k_p σ", 1.0),
    ("kinematics", "nonlinear_fraction", "nonlinear fraction of w", 1.0),
)
_CAPTION = "A dash: not measured, not analysed, or the record is too short"


def compare(title: str, cubes: Sequence[tuple[str, Path]], output: str | Path) -> Path:
    """Write the page of runs, of each its name and where its cube is, or will be."""
    output = Path(output)
    groups = {run: _groups(cube) for run, cube in cubes if cube.is_dir()}
    head = ("run", "verdict", "steps", *(heading for _, _, heading, _ in _COLUMNS), "report")
    rows = [_row(run, cube, groups.get(run), output) for run, cube in cubes]
    sections = [ReportSection("The runs", [Table(_CAPTION, head, rows)])]
    spectra = {
        run: found["spectra"]["Ez_fusion"].where(found["spectra"]["valid_fusion"])
        for run, found in groups.items()
        if "spectra" in found
    }
    if spectra:
        picture = Picture(
            _figure(dict(list(spectra.items())[:MAX_SPECTRA])),
            "Spectra of the elevation, where they are reliable.",
            f"Curves of E(omega) of {', '.join(spectra)}.",
        )
        sections.append(ReportSection("Spectra", [picture]))
    lines = (f"{len(groups)} of {len(cubes)} runs measured",)
    write_text(output, render(Head(title, lines), sections), PAGE)
    return output


def _groups(cube: Path) -> dict[str, xr.Dataset]:
    """Groups of the waves of a cube by name; empty without waves."""
    run, names = open_run(cube), ("statistics", "kinematics", "spectra")
    return {name: group for name in names if (group := run.wave_group(name)) is not None}


def _row(run: str, cube: Path, groups: Mapping[str, xr.Dataset] | None, output: Path) -> list[str]:
    if groups is None:
        return [run, "not run yet", *["–"] * (len(_COLUMNS) + 2)]
    state, verdict = status(cube), "not finished"
    if state.complete:
        verdict = state.verdict.line if state.verdict else "none yet: run it once more"
    values = [
        number(factor * float(groups[group][name])) if name in groups.get(group, ()) else "–"
        for group, name, _, factor in _COLUMNS
    ]
    report, link = beside(cube, "report", ".html"), "–"
    if report.exists():
        path = Path(os.path.relpath(report, output.absolute().parent)).as_posix()
        link = Markup('<a href="{}">report</a>').format(path)
    return [run, verdict, f"{state.steps - state.left} of {state.steps}", *values, link]


def _figure(spectra: Mapping[str, xr.DataArray]) -> Figure:
    figure, [[ax]] = panels(1, width=8.0, height=4.5)
    for k, (run, one) in enumerate(spectra.items()):
        style = {**LINES[k % len(LINES)], "linewidth": 1.0 + 0.8 * (k // len(LINES))}
        ax.loglog(one["omega"].values / (2 * np.pi), one.where(one > 0).values, label=run, **style)
    ax.set(xlabel="ω / 2π (Hz)", ylabel="E(ω) of z (m² s rad⁻¹)")
    frequency_axis(ax)
    plain_axes(ax, **RIGHT)
    return figure
