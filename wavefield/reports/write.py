"""From stores to the report's file."""

from collections.abc import Callable
from pathlib import Path

from wavefield.reports.page import Section, Table, render
from wavefield.reports.player import pack
from wavefield.reports.sections import SECTIONS
from wavefield.reports.sources import Sources, gather
from wavefield.store.beside import beside
from wavefield.store.verdict import Verdict, read_verdict
from wavefield.whole_files import check_writable, write_text


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
    check_writable(output)  # at once, not after all is drawn
    sources = gather(store, waves or beside(store, "waves", ".zarr"))
    return write_report(sources, output, progress, read_verdict(store))


def remarks_section(verdict: Verdict) -> Section:
    """The remarks of a verdict, as a part of the page.

    Parameters
    ----------
    verdict : Verdict
        With one remark at least.

    Returns
    -------
    Section
    """
    rows = [
        (f"{r.subject}: {r.kind}", r.sentence, r.expected or "-", r.remedy or "-") for r in verdict.remarks
    ]
    head = ("remark", "measured", "expected", "what to do")
    return Section("Remarks", [Table(f"The cube is {verdict.line}", head, rows)])


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
    cube = sources.cube
    name = str(cube.attrs.get("experiment", "")) or "unnamed experiment"
    subtitle = f"{cube.sizes['time']} steps of z, u, v, w on {cube.sizes['x']} x {cube.sizes['y']} nodes"
    if verdict:
        subtitle = f"Verdict: {verdict.line}. {subtitle}"
    output = Path(output)
    write_text(output, render(f"{name}: water surface and velocity", subtitle, sections, pack(cube)))
    if progress:
        progress(len(SECTIONS), len(SECTIONS))
    return output
