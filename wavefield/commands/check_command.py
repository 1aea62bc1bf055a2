"""`wavefield check` and `explain`: inspect an experiment before the run, and explain remarks."""

from __future__ import annotations

import difflib
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from wavefield.commands import campaign_commands
from wavefield.commands.progress import Progress, command_line, print_next
from wavefield.commands.sources import JSON, PATH, RIG, experiment_file

if TYPE_CHECKING:
    from wavefield.pipeline.checking import Check
    from wavefield.pipeline.prepare import PreparedRun
    from wavefield.series import Experiment

TRIAL_SECONDS = 600.0  # before a longer run `check` proposes a trial with some of the frames


@click.command(
    epilog="""\b
Examples:
  wavefield check experiment.yaml
  wavefield check experiment.yaml --pairs      # how consistent the cameras are, pair by pair
"""
)
@campaign_commands.takes_source("EXPERIMENT|FOLDER|CUBE|CATALOG")
@RIG
@click.option("--workflow", type=PATH, help="YAML file that says where it would run (page Workflows).")
@click.option("--pairs", is_flag=True, help="Also compare each pair of cameras.")
@JSON
@click.pass_context
def check(
    context: click.Context,
    source: campaign_commands.CommandSource,
    rig: Path | None,
    workflow: Path | None,
    pairs: bool,
    as_json: bool,
) -> None:
    """Show which data are there, which are missing, and what a run will cost.

    Counts the frames of each camera, lists missing ones, and computes how much of the grid all cameras see.
    Measures a few steps to estimate time, memory and disk space of the run. Compares the cameras' images to
    find a camera that is mirrored, swapped, late, reversed, blurred, covered, or has moved. Writes nothing.
    The exit status is 1 if something prevents a run, 3 if the verdict has remarks beyond notes.
    """
    from wavefield import pipeline
    from wavefield.execution.process import keep_memory
    from wavefield.pipeline.prepare import prepare

    keep_memory()
    source = replace(source, path=experiment_file(source.path))

    def inspect(experiment: Path | Experiment, stage: str) -> Check:
        with Progress(stage):
            found = pipeline.check(experiment, rig, workflow)
        if not as_json:
            click.echo(str(found))
        if pairs and not as_json and not found.problems:
            click.echo(_pairs_table(prepare(experiment, rig, workflow)))
        return found

    if not source.is_catalog():
        found = inspect(source.path, "Reading the frames and measuring a few steps")
        if as_json:
            click.echo(json.dumps(found.to_dict(), indent=1, default=str))
        else:
            _next(found, source.path, rig)
        context.exit(found.exit_status)
    from wavefield.pipeline.catalog import find_experiment, runs_of

    runs = [
        (run, find_experiment(source.path, {"run": run, **source.parameters}))
        for run in runs_of(source.path, source.entries)
    ]
    checks: dict[str, Check] = {}

    def work(run: str, experiment: Experiment) -> int:
        checks[run] = inspect(experiment, f"Checking {run}")
        return checks[run].exit_status

    status_of_all = campaign_commands.each(runs, work, quiet=as_json)
    if as_json:
        click.echo(json.dumps({run: one.to_dict() for run, one in checks.items()}, indent=1, default=str))
    else:
        for run, one in checks.items():
            click.echo(f"{run}: {one.line}")
    context.exit(status_of_all)


def _next(found: Check, source: Path, rig: Path | None) -> None:
    """Print the command to run next: `calibrate`, `check` again after a correction, or `run`.
    If the run will take more than 10 minutes, first propose a trial with 50 frames."""
    if found.problems:
        if not found.rig and any("wavefield calibrate" in problem for problem in found.problems):
            print_next("calibrate", source)
        else:
            print_next("check", source, first="correct what is not ready")
        return
    more = ["--rig", rig] if rig else []
    if found.exit_status:
        print_next("check", source, *more, first="correct what the remarks list")
        return
    if found.cost and found.cost.seconds > TRIAL_SECONDS:
        first = found.cameras[0].first
        click.echo(
            f"A trial first: {command_line('run', source, *more, '--frames', f'{first}:{first + 49}')}"
        )
    print_next("run", source, *more)


def _pairs_table(prepared: PreparedRun) -> str:
    """Return a text table of differences between pairs of cameras, in a step near the middle of the record.
    Below it are standard uncertainties, shortest resolved wavelengths, and the width of the beads' images."""
    from wavefield.measurement.diagnostics import diagnose_around, rms_within
    from wavefield.rig.field import pixel_size

    pixel = pixel_size(prepared.rig, prepared.grid)
    middle = len(next(iter(prepared.series.values()))) // 2
    steps = min(len(prepared.series[name]) for name in prepared.geometry.cameras) - 1

    read = prepared.read_uncovered
    found = diagnose_around(read, steps, prepared.geometry, prepared.model, middle)
    if found is None:
        return "  pairs: no step around the middle of the record has a usable frame of every camera"
    lines = [f"  pairs, one step in the middle, rms; 1 px is {1e3 * pixel:.2g} mm"]
    rows = {}
    for quantity, cameras, unit, values in found.errors():
        name, rms = f"{quantity} {cameras}", rms_within(values)[0]
        if " minus " in cameras:  # two errors add up in a difference
            name, rms = f"({name}) / sqrt 2", rms / 2**0.5
        cm, px = (f"{100 * rms:.4f} cm", rms / pixel) if unit == "m" else ("", rms)
        rows[name] = f"{cm:>10} {px:.3f} px"
    width = max(map(len, rows))
    lines += [f"    {name:<{width}} {text}" for name, text in rows.items()]
    noise = ", ".join(f"{name} {value / pixel:.3f}" for name, value in found.noise.items())
    lines.append(f"  standard uncertainty, two frames, px: {noise}")
    carried = ", ".join(f"{name} {100 * length:.1f}" for name, length in found.carried.items())
    lines.append(f"  wavelength of which half the amplitude is kept, cm: {carried}")
    widths = ", ".join(f"{name} {width:.1f}" for name, width in found.widths.items() if width)
    if widths:
        lines.append(f"  width of the beads' images, px (2 in focus): {widths}")
    return "\n".join(lines)


@click.command(
    epilog="""\b
Examples:
  wavefield explain             # all codes
  wavefield explain water-level
"""
)
@click.argument("code", required=False)
@click.pass_context
def explain(context: click.Context, code: str | None) -> None:
    """Explain a remark of `check`, `run` or `status`.

    CODE is the word in brackets at the end of the remark; without it, all codes are listed.
    """
    from wavefield.quality.remarks import EXPLANATIONS

    if code is None:
        formatter = context.make_formatter()
        first_sentences = {name: text.partition(". ")[0].rstrip(".") for name, text in EXPLANATIONS.items()}
        formatter.write_dl([(name, f"{sentence}.") for name, sentence in first_sentences.items()])
        click.echo(formatter.getvalue(), nl=False)
        return
    name = code.strip("[]").lower()
    if name not in EXPLANATIONS:
        near = difflib.get_close_matches(name, EXPLANATIONS, n=1)
        remedy = f"did you mean {near[0]}?" if near else "`wavefield explain` lists all codes"
        raise click.UsageError(f"there is no remark {code!r}; {remedy}")
    click.echo(click.wrap_text(EXPLANATIONS[name], 90))
