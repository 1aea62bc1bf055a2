"""`wavefield calibrate`: from target images to a rig."""

from pathlib import Path

import click

from wavefield.commands.next_command import print_next
from wavefield.commands.progress import Progress
from wavefield.commands.sources import EXPERIMENT, FILE, source_of_experiment
from wavefield.text import short_path


@click.command(
    epilog="""\b
Examples:
  wavefield calibrate experiment.yaml               # writes rig.yaml next to it, and rig_report/
  wavefield calibrate experiment.yaml -o new.yaml
"""
)
@EXPERIMENT
@click.option("-o", "--output", type=FILE, help="Rig file to write.")
@click.option("--anyway", is_flag=True, help="Write the rig although it is refused; the file states why.")
@click.pass_context
def calibrate(context: click.Context, experiment: Path, output: Path | None, anyway: bool) -> None:
    """Calibrate the cameras, the rig, from target images.

    Reads the section `calibration` of EXPERIMENT, finds the target in its tilted and flat views, solves for
    all cameras together, and writes the rig and a report with pictures. Where the experiment names a
    still-water record (`rest:`), it corrects the rig and brings z = 0 to the water. When the rig cannot be
    trusted the exit status is 1 and the report lists the target images to retake.
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
        solving = progress.stage_of("Solving for the cameras", "models")
        result = calibrate_experiment(loaded, progress, solving)
    calibration = result.calibration
    with Progress("Drawing the report"):
        page = write_calibration(calibration, folder, lambda: draw_found(result), report)
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
        from wavefield.pipeline.still_water import level_at_rest, plane_sentence

        with Progress("Matching the still-water images", "frames") as progress:
            rig, found, plane = level_at_rest(loaded.at_rest(), rig, progress=progress)
        click.echo(f"{found.sentence}\n{plane_sentence(plane)}")
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
