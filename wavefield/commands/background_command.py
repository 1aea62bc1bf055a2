"""`wavefield background`: what all frames of a camera have in common, computed once and stored."""

from pathlib import Path

import click

from wavefield.commands.next_command import print_next
from wavefield.commands.sources import EXPERIMENT, frames_option, source_of_experiment

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
    """Average the frames of each camera, to subtract what is fixed.

    Writes background/CAMERA.tif beside the experiment file. Frames are read less these images once the
    experiment file names them with `background:`.
    """
    from wavefield.series import Experiment
    from wavefield.series.mean_images import write_backgrounds

    found = Experiment.load(experiment)
    bare = found.model_copy(update={"background": None}).open_frames()
    folder = found.path.parent / "background"
    for file in write_backgrounds(bare, folder, frames, source_of_experiment(found.path, folder)):
        click.echo(f"Wrote {file}.")
    if found.background is None:
        click.echo(f"To subtract them, add this line to {found.path}:\n  {_KEY}")
    print_next("check", found.path)
