"""Commands that accept a catalog work on its runs, one after the other."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import click

from wavefield.commands.sources import PATH, find_cube
from wavefield.errors import StoreError, WavefieldError

T = TypeVar("T")


@dataclass(frozen=True)
class CommandSource:
    """The argument of a command: an experiment, a cube, or a catalog and some of its runs."""

    path: Path
    entries: tuple[str, ...]  # Runs of a catalog; all if none is named
    parameters: dict[str, str]  # Values of the catalog's parameters

    def is_catalog(self) -> bool:
        """Return whether the path is a catalog; raise UsageError if runs of something else are named."""
        from wavefield.pipeline import is_catalog

        if self.path.is_file() and is_catalog(self.path):
            return True
        if self.entries or self.parameters:
            raise click.UsageError(f"{self.path} is not a catalog: it has no runs and parameters")
        return False

    def cubes(self) -> list[tuple[str, Path]]:
        """Return the names of a catalog's runs and the paths of their newest cubes."""
        from wavefield.pipeline.catalog import cube_of, runs_of

        return [
            (run, cube_of(self.path, {"run": run, **self.parameters}))
            for run in runs_of(self.path, self.entries)
        ]

    def for_each_cube(self, work: Callable[[Path], int]) -> int:
        """Work on the cube, or on the cube of each run of a catalog; return the exit status."""
        return each(self.cubes(), with_cube(work)) if self.is_catalog() else work(find_cube(self.path))


def named(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Return the values of a catalog's parameters, given by words such as ``location=/disk2``."""
    for value in values:
        if "=" not in value:
            raise click.BadParameter(f"{value!r}: write name=value")
    return dict(value.split("=", 1) for value in values)


def takes_source(metavar: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that gives a command the argument `source`, a `CommandSource`."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def with_source(
            *context: click.Context,
            source: Path,
            entries: tuple[str, ...],
            parameters: dict[str, str],
            **options: object,
        ) -> None:
            command(*context, source=CommandSource(source, entries, parameters), **options)

        for parameter in (
            click.option(
                "-p",
                "--parameter",
                "parameters",
                multiple=True,
                callback=named,
                help="Set a parameter of the catalog, such as location=/disk2.",
            ),
            click.argument("entries", nargs=-1, metavar="[RUN]..."),
            click.argument("source", metavar=metavar, type=PATH),
        ):
            parameter(with_source)
        return with_source

    return decorate


def each(runs: Sequence[tuple[str, T]], work: Callable[[str, T], int], quiet: bool = False) -> int:
    """Work on every run and print its name; an error in one does not stop the others.

    Returns the exit status of all of them.
    """
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
    """Return the worst exit status of several: 1 (failed), then 3 (remarks), then 0."""
    return 1 if 1 in statuses else max(statuses, default=0)


def with_cube(work: Callable[[Path], int]) -> Callable[[str, Path], int]:
    """Return the work as `each` calls it; it raises StoreError if a run has no cube yet."""

    def checked(run: str, cube: Path) -> int:
        if not cube.is_dir():
            raise StoreError(f"{run} is not measured yet; run: wavefield run CATALOG {run}")
        return work(cube)

    return checked
