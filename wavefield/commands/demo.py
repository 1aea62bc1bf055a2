"""The demo: the commands that a user would give, on a simulated tank, and the errors against its truth."""

from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
import xarray as xr

from wavefield.commands.next_command import print_next
from wavefield.errors import WavefieldError

MARGIN = 0.04  # m; errors are counted this far inside the edge of what was measured

# variable: label, and what the paper reports on its own tests, mm and px of 1.8 mm
PAPER = {"z": ("z", "0.2-0.7", "0.13-0.4")} | {n: (f"{n} dt", "0.3-0.5", "0.3") for n in "uvw"}


def run_demo(
    directory: Path, command: Callable[[list[str]], int], scene: str = "demo", *, quiet: bool = False
) -> None:
    """Simulate, calibrate, check, run, analyse, report, compare."""
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
    """Errors of a cube against the truth of its simulated experiment, next to the paper's."""
    from wavefield.pipeline import open_run
    from wavefield.reports import errors_against
    from wavefield.rig import Rig
    from wavefield.rig.field import pixel_size

    run = open_run(store, experiment=directory / "experiment.yaml")
    cube = run.cube
    assert run.truth is not None  # the demo wrote it
    errors = inside(errors_against(cube, run.truth), MARGIN)
    pixel = pixel_size(Rig.load(directory / "truth" / "rig.yaml"), run.grid)
    rate = float(cube.attrs["frame_rate"])
    lines = [
        f"rms error against the truth, {MARGIN * 100:g} cm inside the edge, 1 px = {1e3 * pixel:.2f} mm",
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


def inside(errors: xr.Dataset, margin: float) -> xr.Dataset:
    """Errors (time, y, x) without those near the edge of the grid or of the field that was ever measured."""
    from scipy.ndimage import binary_erosion

    nodes = round(margin / float(np.mean(np.diff(errors.x))))
    ever = np.isfinite(errors.z).any("time").transpose("y", "x")
    deep = binary_erosion(ever.values, iterations=nodes) if nodes else ever.values
    return errors.where(ever.copy(data=deep))
