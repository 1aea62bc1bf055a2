"""`wavefield check`, `calibrate`, `run` and `status`: from images to a cube."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wavefield.commands import campaign_commands
from wavefield.commands.progress import Progress

if TYPE_CHECKING:
    from wavefield.measurement.diagnostics import Diagnosis
    from wavefield.pipeline import Check
    from wavefield.pipeline.prepare import PreparedRun
    from wavefield.series import Experiment

_FILE = click.Path(exists=True, path_type=Path)
_HOW = {
    "now": "",
    "half the noise": "light, exposure, gain of the sensor",
    "twice the beads": "seeding",
    "in focus": "focus, aperture",
}
_JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON, for scripts.")


@click.command(
    epilog="""\b
Examples:
  wavefield check experiment.yaml
  wavefield check experiment.yaml --pairs      # do the cameras agree on what they see?
"""
)
@click.argument("source", type=_FILE)
@campaign_commands.ENTRIES
@click.option("--rig", type=_FILE, help="Rig file, in place of the one that the experiment names.")
@click.option("--workflow", type=_FILE, help="Where and how it would run: a file as in workflows/.")
@campaign_commands.PARAMETERS
@click.option(
    "--pairs", is_flag=True, help="Also compare each pair of cameras, and their clocks at more instants."
)
@_JSON
@click.pass_context
def check(
    context: click.Context,
    source: Path,
    entries: tuple[str, ...],
    rig: Path | None,
    workflow: Path | None,
    parameters: dict[str, str],
    pairs: bool,
    as_json: bool,
) -> None:
    """Show what is there, what is missing, and what a run will cost.

    SOURCE is an experiment file or a catalog. Counts the frames of each camera, names missing ones, shows how
    much of the grid the cameras see, measures a few steps to find the time, memory and disk of the whole run,
    and compares the cameras' images: is one mirrored, swapped, late, reversed, blurred, covered, or has it
    moved? Changes nothing. The exit status is 1 where something prevents a run, 3 where the verdict has
    remarks that matter.
    """
    from wavefield import pipeline
    from wavefield.execution.worker_settings import keep_memory

    keep_memory()
    if not campaign_commands.is_campaign(source, entries, parameters):
        with Progress("Looking at the frames, measuring a few steps"):
            found = pipeline.check(source, rig, workflow)
        if as_json:
            click.echo(json.dumps(found.to_dict(), indent=1, default=str))
            context.exit(found.exit_status)
        _report(found, source, rig, workflow, pairs)
        context.exit(found.exit_status)
    from wavefield.pipeline.catalog import find_experiment, runs_of

    runs = [(run, find_experiment(source, {"run": run, **parameters})) for run in runs_of(source, entries)]
    checks: dict[str, Check] = {}

    def work(run: str, experiment: Experiment) -> int:
        with Progress(f"Looking at {run}"):
            checks[run] = pipeline.check(experiment, rig, workflow)
        if not as_json:
            _report(checks[run], experiment, rig, workflow, pairs)
        return checks[run].exit_status

    status_of_all = campaign_commands.each(runs, work, quiet=as_json)
    if as_json:
        click.echo(json.dumps({run: one.to_dict() for run, one in checks.items()}, indent=1, default=str))
    else:
        for run, one in checks.items():
            click.echo(f"{run}: {one.line}")
    context.exit(status_of_all)


def _report(
    found: Check, experiment: Path | Experiment, rig: Path | None, workflow: Path | None, pairs: bool
) -> None:
    click.echo(str(found))
    if words := _probes_line(experiment):
        click.echo(f"  probes: {words}")
    if pairs and not found.problems:
        from wavefield.pipeline.prepare import prepare
        from wavefield.pipeline.run_quality import synchrony_of
        from wavefield.quality.camera_delay import sentence

        prepared = prepare(experiment, rig, workflow)
        click.echo(_pairs_table(prepared))
        delays = sentence(synchrony_of(prepared).delays, 1 / prepared.experiment.frame_rate)
        click.echo(f"  clocks, by more instants: {delays}")


def _reader(prepared: PreparedRun) -> Callable[[str, int], Any]:
    return lambda camera, frame: prepared.series[camera].read_uncovered(frame)


def _probes_line(source: Path | Experiment) -> str:
    """The experiment's probes and their clock and the cameras', or what is wrong with their file."""
    from wavefield.errors import ExperimentError
    from wavefield.series import Experiment

    experiment = source if isinstance(source, Experiment) else Experiment.load(source)
    if not experiment.probes:
        return ""
    try:
        probes = experiment.read_probes()
    except ExperimentError as error:
        return str(error)
    times = experiment.frame_times(next(iter(experiment.open_frames().values())))
    names, clock = ", ".join(probes.probe.values), probes.time.values
    return f"{names}, from {clock[0]:g} to {clock[-1]:g} s; frames from {times[0]:g} to {times[-1]:g} s"


def _pairs_table(prepared: PreparedRun) -> str:
    """What `diagnose` finds around the middle of the record, a line per error."""
    from wavefield.measurement.diagnostics import diagnose_around
    from wavefield.rig.resolution import pixel_size

    pixel = pixel_size(prepared.rig, prepared.grid)
    middle = len(next(iter(prepared.series.values()))) // 2
    steps = min(len(prepared.series[name]) for name in prepared.geometry.cameras) - 1
    found = diagnose_around(_reader(prepared), steps, prepared.geometry, prepared.model, middle, pixel)
    if found is None:
        return "  pairs: no step around the middle of the record has a usable frame of every camera"
    lines = [f"  pairs, {len(next(iter(found.z.values())))} steps, rms; 1 px is {1e3 * pixel:.2g} mm"]
    rows = found.table()
    width = max(len(row["name"]) for row in rows)
    for row in rows:
        centimetres = "" if row["cm"] is None else f"{row['cm']:.4f} cm"
        lines.append(f"    {row['name']:<{width}} {centimetres:>10} {row['px']:.3f} px")
    return "\n".join([*lines, *_carried_lines(found, pixel)])


def _carried_lines(found: Diagnosis, pixel: float) -> list[str]:
    """Which waves these images carry, with how much noise, and what would help."""
    noise = ", ".join(f"{name} {value / pixel:.3f}" for name, value in found.noise.items())
    lines = [f"  standard uncertainty, two frames, px: {noise}"]
    ways = list(next(iter(found.carried.values())))
    lines.append("  waves of which half is kept, cm: " + "; ".join(ways))
    for name, lengths in found.carried.items():
        lines.append(f"    {name} " + "; ".join(f"{100 * lengths[way]:.1f}" for way in ways))
    widths = ", ".join(f"{name} {width:.1f}" for name, width in found.widths.items() if width)
    if widths:
        lines.append(f"  width of the beads' images, px (2 in focus): {widths}")
    helps = {way: sum(one[way] / one["now"] for one in found.carried.values()) for way in ways}
    best = min(helps, key=lambda way: helps[way])
    gain = 1 - helps[best] / len(found.carried)
    if gain > 0.02:
        lines.append(f"  most would help: {best} ({_HOW[best]}): waves {100 * gain:.0f} % shorter")
    return lines


@click.command(
    epilog="""\b
Examples:
  wavefield calibrate experiment.yaml               # writes rig.yaml next to it, and rig_report/
  wavefield calibrate experiment.yaml -o new.yaml
"""
)
@click.argument("experiment", type=_FILE)
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Rig file to write.")
@click.option("--anyway", is_flag=True, help="Write the rig although it is refused; the file states why.")
@click.pass_context
def calibrate(context: click.Context, experiment: Path, output: Path | None, anyway: bool) -> None:
    """Find the rig from target images.

    Reads the calibration chunk of EXPERIMENT, finds the target in its tilted and flat views, solves for all
    cameras together, and writes the rig and a report with pictures. Where the experiment names a record of
    the water at rest (`rest:`), it corrects the rig and brings z = 0 to the water. When the rig cannot be
    trusted the exit status is 1 and the report lists what to photograph again.
    """
    from concurrent.futures import ProcessPoolExecutor

    from wavefield.atomic_write import PAGE, RIG, check_writable
    from wavefield.calibration.images import calibrate_experiment, leave_with_parent, worker_context
    from wavefield.reports.calibration import NUMBERS, write_calibration
    from wavefield.reports.target_pictures import draw_found
    from wavefield.series import Experiment

    loaded = Experiment.load(experiment)
    output = output or loaded.resolve(loaded.rig if isinstance(loaded.rig, str) else "rig.yaml")
    folder = output.with_name(f"{output.stem}_report")
    check_writable(output, RIG)
    check_writable(folder / "index.html", PAGE)
    check_writable(folder / "numbers.yaml", NUMBERS)
    with Progress("Finding the target", "images") as progress:
        result = calibrate_experiment(loaded, progress)
    calibration = result.calibration
    with ProcessPoolExecutor(1, worker_context(), leave_with_parent) as pool:
        drawn = pool.submit(draw_found, result)  # takes as long as all other pictures
        page = write_calibration(calibration, folder, drawn.result)
    for note in (*result.notes, *calibration.notes):
        click.echo(f"note: {note}")
    if not calibration.usable:
        for problem in calibration.problems:
            click.echo(f"not usable: {problem}", err=True)
        if not anyway or not len(calibration.rig):
            again = "" if anyway or not len(calibration.rig) else "; --anyway writes it, marked as refused"
            click.echo(f"No rig was written{again}; the pictures are in {page}.", err=True)
            context.exit(1)
    rig = calibration.rig
    if loaded.rest and calibration.usable:
        from wavefield.pipeline.still_water import level_at_rest, plane_sentence

        with Progress("Matching the water at rest", "frames") as progress:
            rig, found, plane = level_at_rest(loaded.at_rest(), rig, progress=progress)
        click.echo(f"{found.sentence}\n{plane_sentence(plane)}")
    rig.save(output)
    refused = "" if calibration.usable else ", REFUSED (usable: false in the file)"
    click.echo(f"Wrote {output} with {', '.join(rig)}{refused}; how far to trust it: {page}")
    if loaded.rig is None and output.resolve() != loaded.resolve("rig.yaml").resolve():
        click.echo(f"Name it in {experiment} as `rig: {output}`, or give it with --rig")
    click.echo(f"Next: wavefield check {experiment}")


@click.command(
    epilog="""\b
Example:
  wavefield refine rest/experiment.yaml --rig rig.yaml -o rig_rest.yaml
"""
)
@click.argument("experiment", type=_FILE)
@click.option("--rig", type=_FILE, help="Rig file, in place of the one that the experiment names.")
@click.option(
    "-o", "--output", required=True, type=click.Path(dir_okay=False, path_type=Path), help="Rig to write."
)
@click.option(
    "--frames", default=10, show_default=True, type=click.IntRange(min=1), help="How many frames to use."
)
def refine(experiment: Path, rig: Path | None, output: Path, frames: int) -> None:
    """Correct and level a rig with still-water images.

    EXPERIMENT is a record of still, seeded water, or names one (`rest:`). Shows whether a camera has moved
    since the calibration, turns it back so that sight lines meet, brings z = 0 to the water's plane, and
    writes the new rig.
    """
    from wavefield.atomic_write import RIG, check_writable, refuse_input
    from wavefield.pipeline.still_water import level_at_rest, plane_sentence
    from wavefield.series import Experiment

    loaded = Experiment.load(experiment)
    refuse_input(output, *([rig] if rig else loaded.rig_paths))
    check_writable(output, RIG)
    with Progress("Matching the cameras", "frames") as progress:
        still = loaded.at_rest() if loaded.rest else loaded
        refined, found, plane = level_at_rest(still, rig, frames, progress)
    click.echo(found.sentence)
    click.echo(plane_sentence(plane))
    refined.save(output)
    click.echo(f"Wrote {output}; use it with `rig: {output.name}` or --rig.")


@click.command(
    epilog="""\b
Examples:
  wavefield run experiment.yaml                      # writes cube.zarr next to it
  wavefield run experiment.yaml -o cube.zarr --workflow workflows/slurm.yaml
  wavefield run campaign.yaml run07 run08            # entries of a catalog
  wavefield run campaign.yaml -p location=/disk2     # a catalog whose images are elsewhere
"""
)
@click.argument("source", type=_FILE)
@campaign_commands.ENTRIES
@click.option("--rig", type=_FILE, help="Rig file, in place of the one that the experiment names.")
@click.option("--workflow", type=_FILE, help="Where and how to run: a file as in workflows/.")
@click.option("-o", "--output", type=click.Path(file_okay=False, path_type=Path), help="Cube to write.")
@campaign_commands.PARAMETERS
@_JSON
@click.pass_context
def run(
    context: click.Context,
    source: Path,
    entries: tuple[str, ...],
    rig: Path | None,
    workflow: Path | None,
    output: Path | None,
    parameters: dict[str, str],
    as_json: bool,
) -> None:
    """Measure an experiment, or all or some entries of a catalog.

    SOURCE is an experiment file or a catalog. A run that was interrupted goes on where it stopped when the
    same command is given again. The exit status is 1 where nothing could be measured, 3 where the verdict has
    remarks that matter.
    """
    from wavefield import pipeline
    from wavefield.execution.worker_settings import keep_memory

    keep_memory()  # where it measures in this very process
    with Progress(f"Measuring {source}", "steps") as progress:
        how: dict[str, Any] = {"rig": rig, "workflow": workflow}
        if campaign_commands.is_campaign(source, entries, parameters):

            def report_progress(done: int, total: int, sentence: str) -> None:
                progress.stage = f"Measuring {sentence.split(':')[0]}"  # which run of how many
                progress(done, total)

            states = pipeline.run_catalog(
                source, entries, output, parameters=parameters, progress=report_progress, **how
            )
        else:
            states = [
                pipeline.run(source, output, progress=lambda done, total, _: progress(done, total), **how)
            ]
    if as_json:
        click.echo(json.dumps([state.to_dict() for state in states], indent=1, default=str))
    else:
        for state in states:
            click.echo(str(state))
        click.echo(f"Next: wavefield analyze {source if len(states) > 1 else states[0].store}")
    context.exit(campaign_commands.worst([state.exit_status for state in states]))


@click.command(epilog="\b\nExample:\n  wavefield status cube.zarr")
@click.argument("store", metavar="CUBE", type=click.Path(exists=True, file_okay=False, path_type=Path))
@_JSON
@click.pass_context
def status(context: click.Context, store: Path, as_json: bool) -> None:
    """Show the progress of a run, failed frames and why, and the verdict on the cube.

    The exit status is 3 where the verdict has remarks that matter, 1 where nothing could be measured.
    """
    from wavefield.pipeline import status as run_status

    found = run_status(store)
    click.echo(json.dumps(found.to_dict(), indent=1, default=str) if as_json else str(found))
    context.exit(found.exit_status)


@click.command(
    epilog="""\b
Examples:
  wavefield verify cube.zarr
  wavefield verify cube.zarr --quick
  wavefield verify campaign.yaml
"""
)
@click.argument("source", metavar="CUBE|CATALOG", type=_FILE)
@campaign_commands.ENTRIES
@campaign_commands.PARAMETERS
@click.option(
    "--quick",
    is_flag=True,
    help="Read no data: every file there and as long as when it was written? Seconds, for any cube; bytes "
    "that changed in place are not found.",
)
@click.pass_context
def verify(
    context: click.Context,
    source: Path,
    entries: tuple[str, ...],
    parameters: dict[str, str],
    quick: bool,
) -> None:
    """Make sure that a cube holds what its ledger lists: every chunk there, and as it was written.

    The exit status is 1 where something is damaged; the command that measured the cube then measures those
    chunks again.
    """
    from wavefield.store.verify import verify as verify_store

    def work(cube: Path) -> int:
        with Progress(f"Looking at {cube}" if quick else f"Reading {cube}", "chunks") as progress:
            found = verify_store(cube, progress, read=not quick)
        click.echo(str(found))
        return 0 if found.sound else 1

    context.exit(campaign_commands.for_each_cube(source, entries, parameters, work))


@click.command(epilog="\b\nExample:\n  wavefield init run07          # writes run07/experiment.yaml")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Experiment file to write."
)
def init(folder: Path, output: Path | None) -> None:
    """Propose an experiment file for a folder of images, with a comment on every guess.

    Finds the numbered images of each camera, target images, a record at rest and probes by their names. What
    no folder holds (frame rate, target, depth) is marked TO FILL IN. Never writes over a file.
    """
    from wavefield.atomic_write import NEW_FILE, write_text
    from wavefield.errors import ExperimentError
    from wavefield.series.proposal import propose

    output = output or folder / "experiment.yaml"
    if output.exists() or output.is_symlink():
        raise ExperimentError(f"{output} is there already; name another file with -o")
    text = propose(folder)
    write_text(output, text, NEW_FILE)
    click.echo(text)
    click.echo(f"Wrote {output}. Fill it in, then: wavefield check {output}")
