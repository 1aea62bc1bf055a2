"""`wavefield simulate` and `demo`: a simulated experiment, and the errors of its cube."""

from collections.abc import Callable
from pathlib import Path

import click

from wavefield.commands.progress import Progress, print_next
from wavefield.errors import WavefieldError

# by variable: label, and errors in the tests of Aubourg et al. (2019), in mm and in px of 1.8 mm
PAPER = {"z": ("z", "0.2-0.7", "0.13-0.4")} | {n: (f"{n} dt", "0.3-0.5", "0.3") for n in "uvw"}


def run_demo(
    directory: Path, command: Callable[[list[str]], int], scene: str = "demo", *, quiet: bool = False
) -> None:
    """Simulate `scene` in a folder, calibrate, check, run, analyse and report it; then print the errors.
    `command` runs one command line, given as words without `wavefield`, and returns its exit status."""
    experiment, cube = directory / "experiment.yaml", directory / "cube.zarr"
    for words in (
        ["simulate", scene, directory],
        ["calibrate", experiment],
        ["check", experiment],
        ["run", experiment],
        ["analyze", cube],
        ["report", cube],
    ):
        line = [str(word) for word in words]
        if not quiet:
            click.secho(f"\n$ wavefield {' '.join(line)}", bold=True)
        status = command(["-q", *line] if quiet else line)
        if status not in (0, 3):  # 3: remarks, which the demo's pages show
            raise WavefieldError(f"the demo stopped in `wavefield {' '.join(line)}`")
    click.echo("\n" + comparison(cube, directory))
    click.echo(f"\nOpen in a browser:  {directory / 'report.html'}")
    click.echo(f"The calibration:    {directory / 'rig_report' / 'index.html'}")
    print_next("look", cube)


def comparison(store: Path, directory: Path) -> str:
    """Return a table of the rms errors of a cube, next to those in Aubourg et al. (2019), as text.
    `directory` is the folder of the simulated experiment, which holds the exact fields."""
    import numpy as np
    from scipy.ndimage import binary_erosion

    from wavefield.pipeline import open_run
    from wavefield.reports import errors_against
    from wavefield.rig import Rig
    from wavefield.rig.field import pixel_size
    from wavefield.tank.plan import EDGE

    run = open_run(store, experiment=directory / "experiment.yaml")
    cube = run.cube
    assert run.truth is not None  # the demo wrote it
    errors = errors_against(cube, run.truth)
    measured = np.isfinite(errors.z).any("time").transpose("y", "x")
    margin = max(round(EDGE / run.grid.step), 1)
    errors = errors.where(measured.copy(data=binary_erosion(measured.values, iterations=margin)))
    pixel = pixel_size(Rig.load(directory / "truth" / "rig.yaml"), run.grid)
    rate = float(cube.attrs["frame_rate"])
    lines = [
        f"rms error against the truth, {EDGE * 100:g} cm inside the edge, 1 px = {1e3 * pixel:.2f} mm",
        "",
        "           this demo            the paper",
        "            mm      px          mm        px",
    ]
    for name, (label, mm, px) in PAPER.items():
        rms = float(np.sqrt((errors[name] ** 2).mean())) / (1.0 if name == "z" else rate)
        lines.append(f"  {label:5} {1e3 * rms:8.3f} {rms / pixel:7.3f}     {mm:>8}  {px:>8}")
    finite = np.isfinite(errors.z)
    share = 100 * float(finite.sum()) / max(int(finite.any("time").sum()) * errors.sizes["time"], 1)
    lines.append(f"\n{errors.sizes['time']} steps, {share:.1f} % of these nodes have a value")
    return "\n".join(lines)


@click.command(
    epilog="""\b
Examples:
  wavefield demo                          # into ./wavefield-demo
  wavefield demo --scene two_cameras two  # of two cameras, into ./two
"""
)
@click.argument("directory", default="wavefield-demo", type=click.Path(file_okay=False, path_type=Path))
@click.option("--scene", default="demo", show_default=True, help="What to simulate, as for `simulate`.")
def demo(directory: Path, scene: str) -> None:
    """Simulate a small tank, measure it, and compare with the truth.

    Writes a simulated three-camera experiment of 40 steps to DIRECTORY, calibrates the cameras from its
    target images, measures the surface and its velocity, analyses the waves, writes the report, and prints
    the errors next to those of Aubourg et al. (2019). Takes a few minutes and needs no other data.
    """
    meta = click.get_current_context().meta
    run_demo(directory, meta["wavefield.command"], scene, quiet=meta["wavefield.quiet"])


@click.command(
    epilog="""\b
Scenes:
  demo            middle of the tank of Aubourg et al. (2019), a random sea, 43 frames
  two_cameras     the same seen by two cameras, calibrated with a chessboard
  full            the whole of that tank, full-size cameras, a random sea of 1.4 cm rms
  half            the same with images of half the size
  rest            still water
  steep           a steep sea: elevations to 7 cm, slopes to 0.4
  spectra         full size, 515 frames, waves down to 3 cm
  gaps            beads in clusters and places without any
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

    SCENE is a YAML file or the name of a scene below. Makes DIRECTORY. Use it to plan an experiment: which
    camera angle and how many beads lead to which error.
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
