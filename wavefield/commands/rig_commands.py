"""`wavefield calibrate`, `refine`, `rig level` and `rig sheet`: make and correct rigs."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from wavefield.commands.progress import Progress, print_next
from wavefield.commands.sources import EXPERIMENT, FILE, NEW_RIG, RIG, frames_option, source_of_experiment
from wavefield.text import short_path

if TYPE_CHECKING:
    from wavefield.rig import Rig


@click.command(
    epilog="""\b
Examples:
  wavefield calibrate experiment.yaml               # writes rig.yaml next to it, and rig_report/
  wavefield calibrate experiment.yaml -o new.yaml
"""
)
@EXPERIMENT
@click.option("-o", "--output", type=FILE, help="Rig file to write.")
@click.option("--anyway", is_flag=True, help="Write a rig that is refused, with the reason in the file.")
@click.pass_context
def calibrate(context: click.Context, experiment: Path, output: Path | None, anyway: bool) -> None:
    """Calibrate the cameras (the rig) from target images.

    Reads the section `calibration` of EXPERIMENT, finds the target in its tilted and flat views, solves for
    all cameras together, and writes the rig and a report with pictures. If the experiment names a still-water
    record (`rest:`), it also corrects the rig and moves z = 0 to the water. If the rig cannot be trusted, the
    exit status is 1 and the report lists the target images to retake.
    """
    from wavefield.atomic_write import Product, check_writable
    from wavefield.calibration.target_images import calibrate_experiment
    from wavefield.reports.calibration import rig_sentences, write_calibration
    from wavefield.reports.calibration_pictures import draw_found
    from wavefield.series import Experiment

    loaded = Experiment.load(experiment)
    output = output or loaded.resolve(loaded.rig if isinstance(loaded.rig, str) else "rig.yaml")
    folder = output.with_name(f"{output.stem}_report")
    source = source_of_experiment(loaded.path, output)
    report = Product("calibration report", source)
    check_writable(output, Product("rig", source))
    for name in ("index.html", "numbers.yaml"):
        check_writable(folder / name, report)
    with Progress("Finding the target", "images") as progress:
        result = calibrate_experiment(loaded, progress)
    calibration = result.calibration
    with Progress("Drawing the report"):
        page = write_calibration(calibration, folder, draw_found(result), report)
    for note in (*result.notes, *calibration.notes):
        click.echo(f"note: {note}")
    if not calibration.usable:
        for problem in calibration.problems:
            click.echo(f"not usable: {problem}", err=True)
        if not anyway or not len(calibration.rig):
            again = "" if anyway or not len(calibration.rig) else "; --anyway writes it, marked as refused"
            click.echo(f"No rig was written{again}; the pictures are in {short_path(page)}.", err=True)
            print_next("calibrate", experiment, first="retake the target images that are listed")
            context.exit(1)
    rig = calibration.rig
    if loaded.rest and calibration.usable:
        from wavefield.pipeline.prepare import level_at_rest

        with Progress("Matching the still-water images", "frames") as progress:
            rig, found = level_at_rest(loaded.at_rest(), rig, progress=progress)
        click.echo(found)
    for sentence in rig_sentences(rig):
        click.echo(sentence)
    rig.save(output, source)
    refused = "" if calibration.usable else ", REFUSED (usable: false in the file)"
    click.echo(
        f"Wrote {short_path(output)} with {', '.join(rig)}{refused}; calibration report: {short_path(page)}"
    )
    if loaded.rig is None and output.resolve() != loaded.resolve("rig.yaml").resolve():
        click.echo(f"Name it in {experiment} as `rig: {output}`, or give it with --rig")
    if loaded.settings.get("preset") == "sheet" or "sheet_thickness" in loaded.settings:
        print_next("rig", "sheet", experiment, "--rig", output, "-o", output.with_name("sheet.yaml"))
    else:
        print_next("check", experiment)


@click.command(
    epilog="""\b
Examples:
  wavefield rig level sea/experiment.yaml --rig stereo.yaml -o rig.yaml                 # only the level
  wavefield rig level sea/experiment.yaml --rig wass_config --distance 2.5 -o rig.yaml  # only lenses known
"""
)
@EXPERIMENT
@RIG
@NEW_RIG
@click.option(
    "--distance",
    type=click.FloatRange(min=0, min_open=True),
    help="Distance between two cameras, m. Recomputes the second camera's pose from features that both see.",
)
@frames_option(20, "How many instants to use.")
def level(experiment: Path, rig: Path | None, output: Path, distance: float | None, frames: int) -> None:
    """Level cameras, and find their relative pose, from images of the sea.

    For moving water with natural texture. Triangulates features that the cameras share at many instants; the
    plane through them becomes z = 0, whatever axes the rig had before. For still water seeded with beads use
    `wavefield refine`.
    """
    from wavefield.calibration.level_on_water import level_experiment

    _check_output(output, experiment, rig)
    with Progress("Matching the cameras", "instants") as progress:
        found = level_experiment(experiment, rig, distance, frames, progress)
    _save(found.rig, output, experiment, found.sentence)


@click.command(
    epilog="""\b
Examples:
  wavefield rig sheet piv/experiment.yaml -o sheet.yaml                  # of the rig that it names
  wavefield rig sheet piv/experiment.yaml --rig target.yaml -o sheet.yaml
"""
)
@EXPERIMENT
@RIG
@NEW_RIG
@frames_option(50, "How many instants to use.")
def sheet(experiment: Path, rig: Path | None, output: Path, frames: int) -> None:
    """Move z = 0 to a light sheet, found from its particles.

    Correlates simultaneous images of the cameras, projected onto z = 0. The images disagree where the sheet
    is not in the target's plane or a camera has moved; the new rig corrects both errors.
    """
    from wavefield.calibration.light_sheet import find_sheet

    _check_output(output, experiment, rig)
    with Progress("Correlating the cameras", "passes") as progress:
        found = find_sheet(experiment, rig, frames, progress)
    _save(found.rig, output, experiment, found.sentence)


@click.command(
    epilog="""\b
Example:
  wavefield refine rest/experiment.yaml --rig rig.yaml -o rig_rest.yaml
"""
)
@EXPERIMENT
@RIG
@NEW_RIG
@frames_option(10, "How many frames to use.")
def refine(experiment: Path, rig: Path | None, output: Path, frames: int) -> None:
    """Correct and level a rig with still-water images.

    EXPERIMENT is a record of still, seeded water, or names such a record (`rest:`). Shows whether a camera
    has moved since the calibration, rotates it so that sight lines meet again, moves z = 0 to the plane of
    the water, and writes the new rig.
    """
    from wavefield.pipeline.prepare import level_at_rest
    from wavefield.series import Experiment

    _check_output(output, experiment, rig)
    loaded = Experiment.load(experiment)
    with Progress("Matching the cameras", "frames") as progress:
        still = loaded.at_rest() if loaded.rest else loaded
        refined, found = level_at_rest(still, rig, frames, progress)
    _save(refined, output, experiment, found)


def _save(rig: "Rig", output: Path, experiment: Path, found: str) -> None:
    """Print the text `found`, write the rig to the file `output`, and print the command that follows."""
    click.echo(found)
    rig.save(output, source_of_experiment(experiment, output))
    click.echo(f"Wrote {output}; use it with `rig: {output.name}` or --rig.")
    print_next("check", experiment, "--rig", output)


def _check_output(output: Path, experiment: Path, rig: Path | None) -> None:
    """Raise StoreError, before the work, if the rig cannot be written to `output`.
    A file there must be an earlier rig of this experiment, and not one of the rig files to be read."""
    from wavefield.atomic_write import Product, check_writable
    from wavefield.series import Experiment

    inputs = [rig] if rig else Experiment.load(experiment).rig_paths
    check_writable(output, Product("rig", source_of_experiment(experiment, output)), inputs=inputs)
