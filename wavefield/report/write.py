"""From stores to the report's file."""

from collections.abc import Callable
from pathlib import Path

from wavefield.report.page import render
from wavefield.report.player import pack
from wavefield.report.sections import SECTIONS
from wavefield.report.sources import Sources, gather
from wavefield.store.beside import beside
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
    """
    store = Path(store)
    output = Path(output) if output is not None else beside(store, "report", ".html")
    check_writable(output)  # at once, not after all is drawn
    return write_report(gather(store, waves or beside(store, "waves", ".zarr")), output, progress)


def write_report(
    sources: Sources, output: str | Path, progress: Callable[[int, int], None] | None = None
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

    Returns
    -------
    Path
        The file.
    """
    sections = []
    for i, build in enumerate(SECTIONS):
        if progress:
            progress(i, len(SECTIONS))
        section = build(sources)
        if section.items:
            sections.append((section, section.html()))  # drawing is most of the work
    cube = sources.cube
    name = str(cube.attrs.get("experiment", "")) or "unnamed experiment"
    subtitle = f"{cube.sizes['time']} steps of z, u, v, w on {cube.sizes['x']} x {cube.sizes['y']} nodes"
    output = Path(output)
    write_text(output, render(f"{name}: water surface and velocity", subtitle, sections, pack(cube)))
    if progress:
        progress(len(SECTIONS), len(SECTIONS))
    return output
