"""`wavefield demo` and `wavefield simulate`: experiments with exact truth."""

from pathlib import Path

import click

from wavefield.commands.next_command import print_next
from wavefield.commands.progress import Progress


@click.command(
    epilog="""\b
Examples:
  wavefield demo                                # into ./wavefield-demo
  wavefield demo --scene two_cameras /tmp/two   # of two cameras
"""
)
@click.argument("directory", default="wavefield-demo", type=click.Path(file_okay=False, path_type=Path))
@click.option("--scene", default="demo", show_default=True, help="What to simulate, as for `simulate`.")
def demo(directory: Path, scene: str) -> None:
    """Simulate a small tank, measure it, and compare with the truth.

    Writes a simulated three-camera experiment of 40 steps to DIRECTORY, calibrates the cameras from its
    target images, measures the surface and its velocity, analyses the waves, writes the report, and prints
    the errors beside those of the paper. Takes a few minutes and needs nothing but this package.
    """
    from wavefield.commands.demo import run_demo

    meta = click.get_current_context().meta
    run_demo(directory, meta["wavefield.command"], scene, quiet=meta["wavefield.quiet"])


@click.command(
    epilog="""\b
Scenes:
  demo            middle of the paper's tank, a random sea, 43 frames
  two_cameras     the same seen by two cameras, calibrated with a chessboard
  four_cameras    the same seen by four cameras
  full            the paper's tank, full-size cameras, a random sea of 1.4 cm rms
  half            the same with images of half the size
  rest            still water
  steep           a steep sea: elevations to 7 cm, slopes to 0.4
  spectra         full size, 515 frames, waves down to 3 cm
  gaps, holes     beads in clusters and places without any
  lighting        cameras of different brightness, flicker
  low_light       faint beads, noisy cameras
  noisy           twice the noise, beads that one camera misses
  texture         painted texture in place of beads
  sea             the open sea: two cameras on a platform, no target
  sheet           particles in a light sheet, two cameras

\b
Examples:
  wavefield simulate demo tank             # the scene of the demo
  wavefield simulate my_scene.yaml tank    # your own: start from tank/scene.yaml
"""
)
@click.argument("scene")
@click.argument("directory", type=click.Path(file_okay=False, path_type=Path))
def simulate(scene: str, directory: Path) -> None:
    """Write a simulated experiment: images, targets, probes, truth.

    SCENE is a YAML file or the name of a scene below; DIRECTORY is made. Use it to plan an experiment: which
    camera angle, how many beads, what error.
    """
    from wavefield import tank
    from wavefield.tank.scene_parts import PlatformRig

    described = tank.Scene.load(scene)
    with Progress(f"Simulating into {directory}") as progress:
        tank.simulate(described, directory, progress=progress)
    click.echo(f"Wrote {directory}/experiment.yaml; the exact truth is in {directory}/truth.")
    if isinstance(described.rig, PlatformRig):  # no target at sea
        rig, distance = directory / "rig.yaml", described.rig.baseline
        print_next("rig", "level", directory / "experiment.yaml", "--distance", f"{distance:g}", "-o", rig)
    else:
        print_next("calibrate", directory / "experiment.yaml")
