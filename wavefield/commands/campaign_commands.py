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
    """What a command works on: an experiment, a cube, or a catalog and some of its runs."""

    path: Path
    entries: tuple[str, ...]  # names of the runs of a catalog; empty for all runs
    parameters: dict[str, str]  # values that the user set for parameters of the catalog, by name

    def is_catalog(self) -> bool:
        """Return whether the path is a catalog.
        Raises UsageError if it is not, but the user named runs or parameters of a catalog."""
        from wavefield.pipeline import is_catalog

        if self.path.is_file() and is_catalog(self.path):
            return True
        if self.entries or self.parameters:
            raise click.UsageError(f"{self.path} is not a catalog: it has no runs and parameters")
        return False

    def cubes(self) -> list[tuple[str, Path]]:
        """Return the name of each chosen run of a catalog, and the path of its cube; the cube need not exist.
        A run has one cube for each recipe (its settings). The cube is that of the recipe that was run last,
        unless the parameters of the command name another recipe."""
        from wavefield.pipeline.catalog import cube_of, runs_of

        return [
            (run, cube_of(self.path, {"run": run, **self.parameters}))
            for run in runs_of(self.path, self.entries)
        ]

    def for_each_cube(self, work: Callable[[Path], int]) -> int:
        """Call `work` with the cube, or with the cube of each run of a catalog; return the exit status."""
        return each(self.cubes(), with_cube(work)) if self.is_catalog() else work(find_cube(self.path))


def named(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Return the parameters of a catalog as a mapping, from texts such as ``location=/disk2``.
    Raises BadParameter if a text has no "=". `context` and `parameter`, which click passes, do not matter."""
    for value in values:
        if "=" not in value:
            raise click.BadParameter(f"{value!r}: write name=value")
    return dict(value.split("=", 1) for value in values)


def takes_source(metavar: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that gives a command the argument `source`, a `CommandSource`.
    `metavar` stands for the argument in the help text, such as "CUBE|CATALOG"."""

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
    """Call `work` with the name and item of every run; an error in one run does not stop the others.
    Returns the worst exit status of all runs, where a WavefieldError counts as 1. Prints the name of each run
    first, unless `quiet`."""
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
    """Return the worst of several exit statuses: 1 (failed) is worse than 3 (remarks), and 3 than 0."""
    return 1 if 1 in statuses else max(statuses, default=0)


def with_cube(work: Callable[[Path], int]) -> Callable[[str, Path], int]:
    """Return a function of the name and the cube of a run that calls `work` with the cube.
    The function raises StoreError if the run has no cube yet."""

    def checked(run: str, cube: Path) -> int:
        if not cube.is_dir():
            raise StoreError(f"{run} is not measured yet; run: wavefield run CATALOG {run}")
        return work(cube)

    return checked
