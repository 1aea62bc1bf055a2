"""`wavefield init`, `background`, `run`, `status` and `verify`: from images to a cube."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wavefield.commands import campaign_commands
from wavefield.commands.progress import Progress, print_next
from wavefield.commands.sources import (
    CUBE,
    EXPERIMENT,
    FILE,
    JSON,
    PATH,
    RIG,
    STORE,
    experiment_file,
    frames_option,
    is_store,
    source_of_experiment,
)
from wavefield.store import beside

if TYPE_CHECKING:
    from collections.abc import Sequence

    from wavefield.series import Experiment
    from wavefield.store.ledger import Status


def _range(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[int, int] | None:
    """Return the first and last frame in text such as "0:49", or None for None (a callback of click)."""
    if value is None:
        return None
    match = re.fullmatch(r"(\d+):(\d+)", value)
    if not match or int(match[2]) <= int(match[1]):
        raise click.BadParameter(f"{value!r}: write FIRST:LAST, two frames at least, such as 0:49")
    return int(match[1]), int(match[2])


def _trial(source: Path, frames: tuple[int, int], output: Path | None) -> tuple[Experiment, Path]:
    """Return the experiment limited to `frames` (first, last), and the path of its cube.
    The path is `output`, by default cube_FIRST_LAST.zarr. ExperimentError if fewer than two frames exist."""
    from wavefield.errors import ExperimentError
    from wavefield.series import Experiment
    from wavefield.series.experiment_parts import FramesSection

    experiment = Experiment.load(source)
    record = next(iter(experiment.open_frames().values()))
    last_of_record = record.first + len(record) - 1
    first, last = max(frames[0], record.first), min(frames[1], last_of_record)
    if last <= first:
        raise ExperimentError(
            f"--frames {frames[0]}:{frames[1]}: {experiment.path} has the frames {record.first} to "
            f"{last_of_record}; name some of these"
        )
    cut = experiment.model_copy(update={"frames": FramesSection(first=first, last=last)})
    return cut, output or experiment.resolve(f"cube_{first}_{last}.zarr")


@click.command(
    epilog="""\b
Examples:
  wavefield run experiment.yaml                      # writes cube.zarr next to it
  wavefield run .                                    # the experiment in this folder
  wavefield run experiment.yaml --frames 0:49        # a trial, into cube_0_49.zarr
  wavefield run experiment.yaml -o cube.zarr --workflow workflows/slurm.yaml
  wavefield run campaign.yaml run07 run08            # entries of a catalog
  wavefield run campaign.yaml -p location=/disk2     # a catalog whose images are elsewhere
"""
)
@campaign_commands.takes_source("EXPERIMENT|FOLDER|CUBE|CATALOG")
@RIG
@click.option("--workflow", type=PATH, help="YAML file that says where to run (page Workflows).")
@click.option("-o", "--output", type=click.Path(file_okay=False, path_type=Path), help="Cube to write.")
@click.option(
    "--frames",
    metavar="FIRST:LAST",
    callback=_range,
    help="A trial: only the frames from number FIRST to LAST, both included, into a cube of its own.",
)
@JSON
@click.pass_context
def run(
    context: click.Context,
    source: campaign_commands.CommandSource,
    rig: Path | None,
    workflow: Path | None,
    output: Path | None,
    frames: tuple[int, int] | None,
    as_json: bool,
) -> None:
    """Measure an experiment, or all or some runs of a catalog.

    To resume a run that was interrupted, give the same command again, or name its cube. The exit status is 1
    if nothing could be measured, 3 if the verdict on the run has remarks beyond notes.
    """
    from wavefield import pipeline
    from wavefield.execution.process import keep_memory
    from wavefield.pipeline.running import ASSESSING

    keep_memory()  # for runs without worker processes
    if output is None and is_store(source.path):
        output = source.path
    path = experiment_file(source.path)
    source = replace(source, path=path)
    with Progress(f"Measuring {path}", "steps") as progress:
        how: dict[str, Any] = {"rig": rig, "workflow": workflow}
        if source.is_catalog():
            if frames:
                raise click.UsageError("a trial is of one experiment: leave out --frames, or name its file")

            def report_progress(done: int, total: int, sentence: str) -> None:
                progress.stage = f"Measuring {sentence.split(':')[0]}"  # such as "run07 (2 of 5)"
                progress(done, total)

            states = pipeline.run_catalog(
                path, source.entries, output, parameters=source.parameters, progress=report_progress, **how
            )
        else:
            measured, output = _trial(path, frames, output) if frames else (path, output)
            assessing = progress.stage_of(f"Assessing {path}")

            def report(done: int, total: int, sentence: str) -> None:
                if sentence == ASSESSING:
                    assessing(0, 0)
                elif sentence != "done":
                    progress(done, total)

            states = [pipeline.run(measured, output, progress=report, **how)]
    if as_json:
        click.echo(json.dumps([state.to_dict() for state in states], indent=1, default=str))
    else:
        for state in states:
            click.echo(str(state))
        if len(states) == 1 and progress.had_nothing_to_do:
            click.echo(
                f"Nothing to do: all {states[0].steps} steps of {states[0].store} were measured before."
            )
        after = _after(states[0], measured_now=not progress.had_nothing_to_do)
        print_next(after, path if len(states) > 1 else states[0].store)
    context.exit(campaign_commands.worst([state.exit_status for state in states]))


def _after(found: Status, measured_now: bool = False) -> str:
    """Return the command to propose after a run: "analyze" (not for a light sheet), "report" or "look".
    If `measured_now`, the run has just ended, and existing waves and reports are out of date."""
    sheet = found.verdict and any(one.kind == "light sheet" for one in found.verdict.remarks)
    commands = ("report",) if sheet else ("analyze", "report")
    return commands[0] if measured_now else _not_done(found.store, commands)


def _not_done(cube: Path, commands: Sequence[str] = ("analyze", "report")) -> str:
    """Return the first of `commands` whose output is not next to the cube, or "look" if all outputs are."""
    product = {"analyze": ("waves", ".zarr"), "report": ("report", ".html")}
    return next((name for name in commands if not beside(cube, *product[name]).exists()), "look")


@click.command(epilog="\b\nExamples:\n  wavefield status cube.zarr\n  wavefield status .")
@STORE
@JSON
@click.pass_context
def status(context: click.Context, store: Path, as_json: bool) -> None:
    """Show the progress of a run, failed frames, and the verdict.

    The exit status is 3 if the verdict has remarks beyond notes, 1 if nothing could be measured.
    """
    from wavefield.pipeline import status as run_status

    found = run_status(store)
    click.echo(json.dumps(found.to_dict(), indent=1, default=str) if as_json else str(found))
    if not as_json:
        print_next(*((_after(found), store) if found.complete else ("run", store)))
    context.exit(found.exit_status)


@click.command(
    epilog="""\b
Examples:
  wavefield verify cube.zarr
  wavefield verify waves.zarr
  wavefield verify campaign.yaml
"""
)
@campaign_commands.takes_source(f"{CUBE}|CATALOG")
@click.pass_context
def verify(context: click.Context, source: campaign_commands.CommandSource) -> None:
    """Verify that stored results are complete and unchanged.

    Reads all files of a store. The exit status is 1 if something is damaged. Damaged chunks of a cube are
    marked as not measured: the next `wavefield run` measures them again.
    """
    from wavefield.store.verify import verify as verify_store

    def work(cube: Path) -> int:
        with Progress(f"Reading {cube}", "chunks") as progress:
            found = verify_store(cube, progress)
        click.echo(str(found))
        if found.steps:
            print_next(_not_done(cube) if found.sound else "run", cube)
        return 0 if found.sound else 1

    context.exit(source.for_each_cube(work))


@click.command(epilog="\b\nExample:\n  wavefield init run07          # writes run07/experiment.yaml")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("-o", "--output", type=FILE, help="Experiment file to write.")
def init(folder: Path, output: Path | None) -> None:
    """Propose an experiment file for a folder of images.

    Finds the numbered images of each camera and comments on every guess. Values that a folder does not reveal
    (frame rate, depth) are marked TO FILL IN; complete the lines on calibration, rest and probes. Never
    overwrites a file.
    """
    from wavefield.atomic_write import write_text
    from wavefield.errors import ExperimentError
    from wavefield.series.proposal import propose

    output = output or folder / "experiment.yaml"
    if output.exists() or output.is_symlink():
        raise ExperimentError(f"{output} is there already; name another file with -o")
    text = propose(folder)
    write_text(output, text)
    click.echo(text)
    click.echo(f"Wrote {output}.")
    print_next("check", output, first="fill in what is marked TO FILL IN")


_KEY = 'background: "background/{camera}.tif"'


@click.command(
    epilog="""\b
Examples:
  wavefield background experiment.yaml
  wavefield background . --frames 500
"""
)
@EXPERIMENT
@frames_option(200, "How many to average.", least=2)
def background(experiment: Path, frames: int) -> None:
    """Average the frames of each camera, to subtract the fixed background.

    Writes background/CAMERA.tif next to the experiment file. To subtract these images from every frame, name
    them in the experiment file with `background:`.
    """
    from wavefield.series import Experiment
    from wavefield.series.backgrounds import write_backgrounds

    found = Experiment.load(experiment)
    bare = found.model_copy(update={"background": None}).open_frames()
    folder = found.path.parent / "background"
    for file in write_backgrounds(bare, folder, frames, source_of_experiment(found.path, folder)):
        click.echo(f"Wrote {file}.")
    if found.background is None:
        click.echo(f"To subtract them, add this line to {found.path}:\n  {_KEY}")
    print_next("check", found.path)
