"""`wavefield analyze`, `report`, `smooth` and `paper`: from a cube to waves, pages and smoothed fields."""

from pathlib import Path

import click

from wavefield.commands import campaign_commands
from wavefield.commands.progress import Progress, print_next
from wavefield.commands.sources import CUBE, FILE, STORE, find_cube
from wavefield.store import beside
from wavefield.text import short_path

_FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)
_GIVEN = click.Path(exists=True, dir_okay=False, path_type=Path)


@click.command(
    epilog="""\b
Examples:
  wavefield analyze cube.zarr      # writes waves.zarr next to it
  wavefield analyze .              # the cube in this folder
"""
)
@campaign_commands.takes_source(f"{CUBE}|CATALOG")
@click.option("-o", "--output", type=click.Path(file_okay=False, path_type=Path), help="Wave store to write.")
@click.option(
    "--segment",
    type=click.IntRange(min=8),
    help="Steps per Welch segment; by default chosen from the record.",
)
@click.option(
    "--workflow",
    type=_GIVEN,
    help="YAML file that says where to compute (page Workflows); default: the cores of this machine.",
)
@click.pass_context
def analyze(
    context: click.Context,
    source: campaign_commands.CommandSource,
    output: Path | None,
    segment: int | None,
    workflow: Path | None,
) -> None:
    """Compute the waves of a cube: spectra, coherence, statistics.

    Also fits the dispersion relation, combines z and w into one elevation spectrum, and computes directions
    and bicoherence. Writes one Zarr store, which `xarray.open_datatree` reads. For a catalog, it analyses
    every run.
    """
    if output and source.is_catalog():
        raise click.UsageError("the waves of a campaign are written next to its cubes; leave out -o")
    exit_status = source.for_each_cube(lambda cube: _analyze(cube, output, segment, workflow))
    print_next("report", source.path)
    context.exit(exit_status)


def _analyze(store: Path, output: Path | None, segment: int | None, workflow: Path | None) -> int:
    """Analyse a cube, in this process or on the workers of a workflow file.
    Return the exit status: 3 if steps of the cube are not measured, else 0."""
    from wavefield.pipeline import open_run
    from wavefield.pipeline.analysis import analyze as analyze_cube
    from wavefield.store.ledger import unfinished_note

    note = unfinished_note(store)
    if note:
        click.echo(f"note: {note}", err=True)
    output = output or beside(store, "waves", ".zarr")
    run = open_run(store)
    if run.probes is None and run.experiment is not None and run.experiment.probes:
        click.echo(f"note: without the probes {run.reason('probes')}", err=True)
    with Progress(f"Analysing {short_path(store)}") as progress:
        probes = run.probes
        analyze_cube(store, output, workflow=workflow, progress=progress, segment=segment, probes=probes)
    click.echo(f"Wrote {short_path(output)}.")
    return 3 if note else 0


@click.command(
    epilog="""\b
Examples:
  wavefield report cube.zarr      # writes report.html next to it
  wavefield report .
"""
)
@campaign_commands.takes_source(f"{CUBE}|CATALOG")
@click.option("-o", "--output", type=FILE, help="HTML file to write.")
@click.pass_context
def report(context: click.Context, source: campaign_commands.CommandSource, output: Path | None) -> None:
    """Write the report of a cube: one HTML file that opens offline.

    For a catalog, it writes the report of every chosen run, and a page that compares these runs. The option
    -o names this page, which is otherwise next to the catalog.
    """
    from wavefield.reports.compose import report as write

    catalog = source.is_catalog()

    def work(cube: Path) -> int:
        page = beside(cube, "report", ".html") if catalog or output is None else output
        with Progress(f"Drawing {short_path(page)}", "parts") as progress:
            write(cube, page, progress=progress)
        click.echo(f"Wrote {short_path(page)}; open it in a browser.")
        return 0

    status = source.for_each_cube(work)
    if not catalog:
        print_next("look", find_cube(source.path))
        context.exit(status)
    from wavefield.reports.campaign import compare

    cubes = source.cubes()
    page = compare(source.path.stem, cubes, output or source.path.with_suffix(".html"))
    runs = "one run" if len(cubes) == 1 else f"a comparison of {len(cubes)} runs"
    click.echo(f"Wrote {short_path(page)}, {runs}; open it in a browser.")
    print_next("look", source.path, cubes[0][0])
    context.exit(status)


@click.command(
    epilog="\b\nExample:\n  wavefield paper cube.zarr --rest rest.zarr      # writes paper.html next to it"
)
@STORE
@click.option("--rest", type=_FOLDER, help="Cube of still water, from the same cameras.")
@click.option("-o", "--output", type=FILE, help="HTML file to write.")
def paper(store: Path, rest: Path | None, output: Path | None) -> None:
    """Draw the figures of Aubourg and others (2019) from this cube, and compare the numbers.

    Writes one HTML file: a snapshot, distributions, spectra, nonlinear term and coherence, probes, still
    water, differences between pairs of cameras, and a table with the published numbers. Run `wavefield
    analyze` first.
    """
    from wavefield.reports.paper import paper as write

    output = output or beside(store, "paper", ".html")
    with Progress(f"Drawing {output}", "parts") as progress:
        write(store, output, rest=rest, progress=progress)
    click.echo(f"Wrote {output}; open it in a browser.")
    print_next("look", store)


@click.command(epilog="\b\nExample:\n  wavefield smooth cube.zarr      # writes smooth.zarr next to it")
@STORE
@click.option("-o", "--output", type=click.Path(file_okay=False, path_type=Path), help="Zarr store to write.")
def smooth(store: Path, output: Path | None) -> None:
    """Smooth z, u, v, w over time with a model of free waves.

    Writes a Zarr store, which xarray reads, of the smoothed variables and their standard uncertainties.
    Compute spectra from the cube itself: the noise of smoothed fields is correlated.
    """
    from wavefield.pipeline.analysis import write_smoothed

    with Progress(f"Smoothing {short_path(store)}", "steps") as progress:
        output = write_smoothed(store, output, progress)
    click.echo(f"Wrote {short_path(output)}.")
