"""From stores to the report's file."""

from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import numpy as np

from wavefield.atomic_write import PAGE, check_writable, write_text
from wavefield.reports.camera_pictures import camera_history
from wavefield.reports.field_sections import coverage
from wavefield.reports.html_page import Head, Picture, ReportSection, Table, render
from wavefield.reports.number_text import median_of, number
from wavefield.reports.player import pack
from wavefield.reports.report_sections import SECTIONS
from wavefield.reports.sources import Sources, gather
from wavefield.store.store_paths import beside
from wavefield.store.verdict import Verdict, read_verdict
from wavefield.text import spell_time


def report(
    store: str | Path,
    output: str | Path | None = None,
    *,
    waves: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write the report of a cube as one HTML file that opens offline.

    Parameters
    ----------
    store : path
        The cube.
    output : path, optional
        File to write; by default beside the cube.
    waves : path, optional
        Its waves; by default those that lie beside it, if any do.
    progress : callable, optional
        Told (parts done, all parts).

    Returns
    -------
    Path
        The file.

    Raises
    ------
    StoreError
        If the cube is not there, or the file cannot be written.

    Examples
    --------
    >>> import wavefield as wf
    >>> page = wf.report("cube.zarr", "report.html")  # doctest: +SKIP
    >>> page.name  # doctest: +SKIP
    'report.html'
    """
    store = Path(store)
    output = Path(output) if output is not None else beside(store, "report", ".html")
    check_writable(output, PAGE)  # at once, not after all is drawn
    sources = gather(store, waves or beside(store, "waves", ".zarr"))
    return write_report(sources, output, progress, read_verdict(store))


def remarks_section(verdict: Verdict) -> ReportSection:
    """The remarks of a verdict, as a part of the page."""
    rows = [
        (f"{r.subject}: {r.kind}", r.sentence, r.expected or "-", r.remedy or "-") for r in verdict.remarks
    ]
    head = ("remark", "measured", "expected", "what to do")
    return ReportSection("Remarks", [Table(f"The cube is {verdict.line}", head, rows)])


def cameras_section(sources: Sources, verdict: Verdict) -> ReportSection:
    """What each camera showed over the record, as the run looked at it."""
    section = ReportSection("Cameras over time")
    if not verdict.cameras or not verdict.frames:
        return section
    cube = sources.cube
    first = float(cube.time[0]) - 0.5 / float(cube.attrs["frame_rate"])
    time = [first + k / float(cube.attrs["frame_rate"]) for k in verdict.frames]
    each = "; ".join(
        f"{name}: details of {number(median_of(c['blur']), 'px', 2)}, brightness "
        f"{number(median_of(c['brightness']))}, at least {100 * np.nanmin(c['coverage']):.0f} % in view"
        for name, c in verdict.cameras.items()
    )
    caption = (
        f"Every camera at {len(time)} instants of the record: details that grow wider have lost their "
        "focus, brightness that drops its light; what is missing from 100 % of the view is covered. Below, "
        "each pair of cameras alone, before anything is rejected: where sight lines miss each other more and "
        "more, a camera has been moved."
    )
    section.items.append(
        Picture(camera_history(time, verdict.cameras, verdict.pairs), caption, f"Curves. {each}.")
    )
    return section


def head_of(sources: Sources, verdict: Verdict | None) -> Head:
    """What the report says first: verdict, description, dates."""
    cube = sources.cube
    name = str(cube.attrs.get("experiment", "")) or "unnamed experiment"
    rate = float(cube.attrs["frame_rate"])
    lasted = cube.sizes["time"] / rate
    size = (
        f"{cube.sizes['time']} steps at {rate:g} Hz "
        f"({spell_time(lasted) if lasted > 120 else f'{lasted:.4g} s'}) of the "
        f"surface and its velocity, on {cube.sizes['x']} x {cube.sizes['y']} nodes "
        f"{100 * sources.grid.step:g} cm apart"
    )
    dates = [f"{what} {when}" for what, when in sources.dates.items()]
    made = f"this page made {datetime.now().astimezone():%Y-%m-%d %H:%M %Z}".strip()
    when = "; ".join([*dates, made])
    described = sources.experiment.description if sources.experiment else ""
    return Head(
        f"{name}: water surface and velocity",
        (described, f"{size}.", f"{when[0].upper()}{when[1:]}."),
        verdict.line if verdict else "",
        verdict.weight if verdict else "note",
    )


def write_report(
    sources: Sources,
    output: str | Path,
    progress: Callable[[int, int], None] | None = None,
    verdict: Verdict | None = None,
) -> Path:
    """Write the report as one HTML file.

    Parameters
    ----------
    sources : Sources
        The cube and what lies beside it.
    output : path
        File to write.
    progress : callable, optional
        Told (parts done, all parts).
    verdict : Verdict, optional
        On the cube: its line goes on top, its remarks into a part of their own.

    Returns
    -------
    Path
        The file.
    """
    sections = []
    if verdict and verdict.remarks:
        part = remarks_section(verdict)
        sections.append((part, part.html()))
    for i, build in enumerate(SECTIONS):
        if progress:
            progress(i, len(SECTIONS))
        section = build(sources)
        if section.items:
            sections.append((section, section.html()))  # drawing is most of the work
        if build is coverage and verdict:
            part = cameras_section(sources, verdict)
            if part.items:
                sections.append((part, part.html()))
    output = Path(output)
    write_text(output, render(head_of(sources, verdict), sections, pack(sources.cube)), PAGE)
    if progress:
        progress(len(SECTIONS), len(SECTIONS))
    return output
