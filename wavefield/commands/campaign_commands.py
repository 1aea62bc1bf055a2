"""Let commands accept a catalog (a list of experiments, called its runs) and work on the runs in turn."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import click

from wavefield.commands.sources import PATH, find_cube
from wavefield.errors import StoreError, WavefieldError

T = TypeVar("T")


@dataclass(frozen=True)
class CommandSource:
    """The path that a command works on: an experiment, a cube, or a catalog, of which runs can be chosen."""

    path: Path
    entries: tuple[str, ...]  # names of the runs of a catalog; empty for all runs
    parameters: dict[str, str]  # values that the user set for parameters of the catalog, by name

    def is_catalog(self) -> bool:
        """Return whether the path is a catalog. UsageError if it is not, but runs or parameters are given."""
        from wavefield.pipeline.catalog import is_catalog

        if self.path.is_file() and is_catalog(self.path):
            return True
        if self.entries or self.parameters:
            raise click.UsageError(f"{self.path} is not a catalog: it has no runs and parameters")
        return False

    def cubes(self) -> list[tuple[str, Path]]:
        """Return (name, path of the latest cube) for each chosen run of a catalog; cubes need not exist.
        `parameters["recipe"]`, 8 digits that identify the settings of a cube, selects this cube instead."""
        from wavefield.pipeline.catalog import cube_of, runs_of

        return [
            (run, cube_of(self.path, {"run": run, **self.parameters}))
            for run in runs_of(self.path, self.entries)
        ]

    def for_each_cube(self, work: Callable[[Path], int]) -> int:
        """Call `work` with the path of the cube, or of the cube of each chosen run of a catalog.
        Return the exit status that `work` returned; for a catalog, the worst one."""

        def checked(run: str, cube: Path) -> int:
            if not cube.is_dir():
                raise StoreError(f"{run} is not measured yet; run: wavefield run CATALOG {run}")
            return work(cube)

        return each(self.cubes(), checked) if self.is_catalog() else work(find_cube(self.path))


def named(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Return parameters of a catalog by name, from texts like ``location=/disk2`` (a callback of click)."""
    for value in values:
        if "=" not in value:
            raise click.BadParameter(f"{value!r}: write name=value")
    return dict(value.split("=", 1) for value in values)


def takes_source(metavar: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that gives a command three arguments: a path, names of runs, and --parameter.
    `metavar` names the path in the help. The command receives all three as `source`, a CommandSource."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def with_source(*context: Any, source: Path, entries: Any, parameters: Any, **options: Any) -> None:
            command(*context, source=CommandSource(source, entries, parameters), **options)

        click.option(
            "-p",
            "--parameter",
            "parameters",
            multiple=True,
            callback=named,
            help="Set a parameter of the catalog, such as location=/disk2.",
        )(with_source)
        click.argument("entries", nargs=-1, metavar="[RUN]...")(with_source)
        click.argument("source", metavar=metavar, type=PATH)(with_source)
        return with_source

    return decorate


def each(runs: Sequence[tuple[str, T]], work: Callable[[str, T], int], quiet: bool = False) -> int:
    """Call `work` with each name and item in `runs`; return the worst exit status that it returned.
    A WavefieldError counts as status 1 and does not end the loop. Names are printed unless `quiet`."""
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
