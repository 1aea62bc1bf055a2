"""Compose the report of a run and write it as one HTML file."""

from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path

from wavefield.atomic_write import Product, check_writable, write_text
from wavefield.errors import StoreError
from wavefield.pipeline import Run, open_run
from wavefield.reports.accuracy import accuracy
from wavefield.reports.calibration import calibration_section
from wavefield.reports.fields import coverage, distributions, elevation, setup
from wavefield.reports.html import Head, ReportSection, render
from wavefield.reports.numbers import RunNumbers, in_light_sheet
from wavefield.reports.result import attention, recipe, result, run_summary
from wavefield.reports.waves import nonlinearity, spectra
from wavefield.store import beside
from wavefield.store.recipe import source_of
from wavefield.store.verdict import Verdict, read_verdict


def report(
    store: str | Path,
    output: str | Path | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write the report of a cube: one HTML file that opens without a network connection.

    Parameters
    ----------
    store : path
        Cube written by `run`.
    output : path, optional
        File to write; by default ``report.html`` next to ``cube.zarr``, ``a_report.html`` next to ``a.zarr``.
    progress : callable, optional
        Called with the number of sections drawn and the number of all sections.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    StoreError
        If the cube does not exist or has no measured step, or if the file cannot be written, for example
        because `output` exists and is not an earlier report.

    Examples
    --------
    >>> import wavefield as wf
    >>> page = wf.report("cube.zarr", "report.html")  # doctest: +SKIP
    >>> page.name  # doctest: +SKIP
    'report.html'
    """
    run = measured_run(store)
    output = Path(output) if output is not None else beside(run.store, "report", ".html")
    check_writable(output, Product("report", source_of(run.cube)), inputs=[run.store])
    return write_report(run, output, progress, read_verdict(run.store))


def measured_run(store: str | Path) -> Run:
    """Return the run that writes or wrote a cube; raise StoreError if none of its steps is finished yet."""
    run = open_run(store)
    if not (run.cube.frame_status.values > 0).any():
        raise StoreError(f"{store} has no measured step yet; run `wavefield run` first")
    return run


def write_report(
    run: Run,
    output: str | Path,
    progress: Callable[[int, int], None] | None = None,
    verdict: Verdict | None = None,
) -> Path:
    """Write the report of a run, with the verdict if there is one, as one HTML file; return `output`.
    `progress` is called with the number of sections drawn and the number of all sections."""
    output = Path(output)
    sections = build_all(builders_of(run, verdict), progress)
    write_text(output, render(head_of(run, verdict), sections), Product("report", source_of(run.cube)))
    return output


def builders_of(run: Run, verdict: Verdict | None) -> list[Callable[[], ReportSection]]:
    """Return functions, in the order of the report, that each draw one section.
    For velocities in a light sheet, the sections on waves, elevation and distributions are left out."""
    numbers = RunNumbers(run)
    builders: list[Callable[[], ReportSection]] = [partial(result, numbers), partial(attention, run, verdict)]
    of_surface = [] if in_light_sheet(run) else [spectra, nonlinearity, distributions]
    builders += [partial(elevation, run)] if of_surface else []
    builders += [partial(run_summary, numbers)]
    builders += [partial(build, run) for build in (*of_surface, accuracy, coverage)]
    return [*builders, partial(setup, run), partial(calibration_section, run), partial(recipe, run)]


def build_all(
    builders: list[Callable[[], ReportSection]], progress: Callable[[int, int], None] | None
) -> list[ReportSection]:
    """Call the functions `builders`, and return the sections that they draw.
    `progress` is called with the number of sections drawn and the number of all sections."""
    sections = []
    for k, build in enumerate(builders):
        if progress:
            progress(k, len(builders))
        sections.append(build())
    if progress:
        progress(len(builders), len(builders))
    return sections


def head_of(run: Run, verdict: Verdict | None) -> Head:
    """Return the top of the report: title, description of the experiment, date, and one-line verdict."""
    made = f"This page made {datetime.now().astimezone():%Y-%m-%d %H:%M %Z}".strip()
    return Head(
        f"{experiment_name(run)}: {'velocity' if in_light_sheet(run) else 'water surface and velocity'}",
        (run.experiment.description if run.experiment else "", f"{made}."),
        verdict.line if verdict else "",
        verdict.weight if verdict else "note",
    )


def experiment_name(run: Run) -> str:
    """Return the name of the experiment of a run, or "unnamed experiment"."""
    return str(run.cube.attrs.get("experiment", "")) or "unnamed experiment"
