"""`wavefield demo` and `wavefield simulate`: experiments with exact truth."""

from pathlib import Path

import click

from wavefield.commands.next_command import print_next
from wavefield.commands.progress import Progress


@click.command(
    epilog="""\b
Example:
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
Example:
  wavefield simulate demo tank             # the scene of the demo
  wavefield simulate my_scene.yaml tank    # your own: start from tank/scene.yaml
"""
)
@click.argument("scene")
@click.argument("directory", type=click.Path(file_okay=False, path_type=Path))
def simulate(scene: str, directory: Path) -> None:
    """Write a simulated experiment: images, targets, probes, truth.

    SCENE is a YAML file or the name of a scene that comes with the program; DIRECTORY is made. Use it to plan
    an experiment: which camera angle, how many beads, what error.
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
