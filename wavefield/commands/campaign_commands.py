"""What commands do with a catalog: the same with each of its runs, one after the other."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import click

from wavefield.commands.sources import find_cube
from wavefield.errors import StoreError, WavefieldError

T = TypeVar("T")

ENTRIES = click.argument("entries", nargs=-1, metavar="[RUN]...")


def named(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Values of a catalog's parameters, from words such as ``location=/disk2``."""
    for value in values:
        if "=" not in value:
            raise click.BadParameter(f"{value!r}: write name=value")
    return dict(value.split("=", 1) for value in values)


PARAMETERS = click.option(
    "-p",
    "--parameter",
    "parameters",
    multiple=True,
    callback=named,
    help="name=value for a catalog's parameter.",
)


def is_campaign(source: Path, entries: Sequence[str], parameters: Mapping[str, str] | None = None) -> bool:
    """Whether a command was given a catalog; runs of anything else are wrong use."""
    from wavefield.pipeline import is_catalog

    if source.is_file() and is_catalog(source):
        return True
    if entries or parameters:
        raise click.UsageError(f"{source} is not a catalog: it has no runs and parameters")
    return False


def cubes_of(source: Path, entries: Sequence[str], parameters: Mapping[str, str]) -> list[tuple[str, Path]]:
    """Names and newest cubes of a catalog's runs."""
    from wavefield.pipeline.catalog import cube_of, runs_of

    return [(run, cube_of(source, {"run": run, **parameters})) for run in runs_of(source, entries)]


def each(runs: Sequence[tuple[str, T]], work: Callable[[str, T], int], quiet: bool = False) -> int:
    """Work on every run and print which; an error of one does not keep the others."""
    statuses = []
    for number, (run, item) in enumerate(runs, 1):
        if not quiet:
            click.echo(f"{run} ({number} of {len(runs)})")
        try:
            statuses.append(work(run, item))
        except WavefieldError as error:
            click.echo(f"  {error}", err=True)
            statuses.append(1)
    return worst(statuses)


def worst(statuses: Sequence[int]) -> int:
    """The exit status of several: 1 before 3 before 0."""
    return 1 if 1 in statuses else max(statuses, default=0)


def with_cube(work: Callable[[Path], int]) -> Callable[[str, Path], int]:
    """The same for `each`, with an error where a run has no cube yet."""

    def checked(run: str, cube: Path) -> int:
        if not cube.is_dir():
            raise StoreError(f"{run} is not measured yet; `wavefield run CATALOG {run}` does it")
        return work(cube)

    return checked


def for_each_cube(
    source: Path, entries: Sequence[str], parameters: Mapping[str, str], work: Callable[[Path], int]
) -> int:
    """Work on a cube, or on those of a catalog's runs; returns the exit status."""
    if not is_campaign(source, entries, parameters):
        return work(find_cube(source))
    return each(cubes_of(source, entries, parameters), with_cube(work))
