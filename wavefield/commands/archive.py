"""`wavefield export`, `catalog` and `rig`: exchange with other programs."""

import re
import warnings
from pathlib import Path

import click

from wavefield.commands.progress import Progress, print_next
from wavefield.commands.rig_commands import level, sheet
from wavefield.commands.sources import CUBE, EXPERIMENT, FILE, PATH, find_cube


@click.command(
    epilog="""\b
Examples:
  wavefield export cube.zarr cube.nc                    # NetCDF (CF)
  wavefield export cube.zarr cube.mat                   # MATLAB
  wavefield export cube.zarr cube.nc --steps 0:500:5    # every fifth step
  wavefield export cube.zarr run7.uvmat                 # a folder of files for UVMAT
"""
)
@click.argument("store", metavar=CUBE, type=PATH)
@click.argument("output", type=click.Path(path_type=Path))
@click.option("--steps", help="Some of the steps, counted from 0: FIRST:STOP or FIRST:STOP:EVERY.")
@click.pass_context
def export(context: click.Context, store: Path, output: Path, steps: str | None) -> None:
    """Write a cube as NetCDF, MATLAB or UVMAT files.

    The ending of OUTPUT chooses the format. The exit status is 3 if steps of the cube are missing.
    """
    from wavefield.store import export as exports
    from wavefield.store.ledger import unfinished_note

    if output.suffix.lower() not in exports.ENDINGS:
        raise click.UsageError(
            f"{output} is not a supported output format: let its name end in {exports.KNOWN}"
        )
    store = find_cube(store)
    note = unfinished_note(store)
    with Progress(f"Writing {output}"), warnings.catch_warnings():
        warnings.simplefilter("ignore" if note else "default", UserWarning)  # printed below
        exports.export(store, output, _slice(steps))
    click.echo(f"Wrote {output}.")
    if note:
        click.echo(f"note: {note}", err=True)
        context.exit(3)


def _slice(words: str | None) -> slice | None:
    """Return the slice of steps that `words`, such as "0:500:5", describes; None if `words` is None."""
    if words is None:
        return None
    match = re.fullmatch(r"(\d*):(\d*)(?::(0*[1-9]\d*)?)?", words)
    if not match:
        raise click.BadParameter(f"--steps {words!r}: write FIRST:STOP or FIRST:STOP:EVERY, such as 0:500:5")
    return slice(*(int(part) if part else None for part in match.groups()))


@click.group()
def catalog() -> None:
    """Keep a list of experiments and their cubes in one file."""


@catalog.command(epilog="\b\nExample:\n  wavefield catalog add campaign.yaml run07/experiment.yaml")
@click.argument("catalog", type=FILE)
@EXPERIMENT
def add(catalog: Path, experiment: Path) -> None:
    """Add an experiment to a catalog; a missing catalog is made.

    The catalog is an intake file: `intake.open_catalog` opens it, and `wavefield run CATALOG` runs all or
    some of its experiments.
    """
    from wavefield.pipeline.catalog import catalog_add

    name = catalog_add(catalog, experiment)
    click.echo(f"{catalog} now has {name}.")
    print_next("run", catalog, name)


_PROGRAMS = ("wavefield", "uvmat", "opencv", "matlab")


class _Files(click.Group):
    """The command group `rig`: without a command name, as in `rig FILE`, it runs its command `convert`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, "-h", "--help"):
            args = ["convert", *args]
        return super().parse_args(ctx, args)


@click.group(
    cls=_Files,
    epilog="""\b
Examples:
  wavefield rig rig.yaml                             # show it
  wavefield rig cal.xml -o rig.yaml                  # from VIC-3D or OpenCV
  wavefield rig level sea/experiment.yaml -o rig.yaml
  wavefield rig sheet piv/experiment.yaml -o rig.yaml
""",
)
def rig() -> None:
    """Show, convert or level a rig: the geometry of all cameras."""


rig.add_command(level)
rig.add_command(sheet)


@rig.command(
    epilog="""\b
Examples:
  wavefield rig convert rig.yaml                                # show it; `convert` may be left out
  wavefield rig convert cal.xml -o rig.yaml                     # from VIC-3D or OpenCV
  wavefield rig convert cam1=a.xml cam2=b.xml --size 1024x1024 -o rig.yaml    # from UVMAT, a file per camera
  wavefield rig convert rig.yaml --to opencv -o rig_opencv.yaml
  wavefield rig convert rig.yaml --to uvmat -o uvmat/           # a folder with a file per camera
"""
)
@click.argument("files", nargs=-1, required=True)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="File or folder to write.")
@click.option(
    "--to",
    type=click.Choice(_PROGRAMS),
    default="wavefield",
    show_default=True,
    help="Whose format to write.",
)
@click.option("--size", multiple=True, help="Image size where the file does not state it: WxH or camera=WxH.")
@click.option("--unit", help="Unit of length, or its size in metres, if neither file nor format defines it.")
def convert(
    files: tuple[str, ...], output: Path | None, to: str, size: tuple[str, ...], unit: str | None
) -> None:
    """Show a rig, or convert it between the formats of wavefield and other programs.

    FILES is one file, or camera=file for each camera, in the format of wavefield, UVMAT, VIC-3D, DICe, DaVis,
    OpenCV or MATLAB. For other programs, write the numbers into a rig.yaml by hand (page Rig file).
    """
    from wavefield.atomic_write import atomic, refuse_input
    from wavefield.rig import formats

    named = dict(entry.split("=", 1) for entry in files if "=" in entry)
    if len(files) > 1 and len(named) < len(files):
        raise click.UsageError("give one file, or camera=file for each camera")
    sizes = _sizes(size, list(named))
    loaded = formats.load_rig(named or files[0], sizes, unit=unit)
    if output is None:
        for name, camera in loaded.cameras.items():
            x, y, z = camera.centre
            click.echo(
                f"{name}: {camera.size[0]} x {camera.size[1]} px, at ({x:.3f}, {y:.3f}, {z:.3f}) m, "
                f"fx {camera.fx:.1f} px, k1 {camera.k1:g}"
            )
        return
    refuse_input(output, *(named.values() or files))
    if to == "wavefield":
        loaded.save(output)
    else:
        with atomic(output) as draft:
            if to == "uvmat":
                draft.mkdir()
            formats.save_rig(loaded, draft, to)
    click.echo(f"Wrote {output} with {', '.join(loaded)}.")
    if to == "wavefield":
        print_next("check", "experiment.yaml", "--rig", output)


def _sizes(given: tuple[str, ...], names: list[str]) -> dict[str, tuple[int, int]]:
    """Return image sizes (width, height), px, by camera, from texts such as 1024x1024 and cam1=1024x1024.
    A text without a camera applies to all cameras in `names`, or to cam1 to cam4 if `names` is empty."""
    out: dict[str, tuple[int, int]] = {}
    for entry in given:
        name, _, words = entry.rpartition("=")
        try:
            width, height = (int(word) for word in words.lower().split("x"))
        except ValueError:
            raise click.BadParameter(f"{entry!r}: write WxH or camera=WxH, such as 1024x1024") from None
        out |= dict.fromkeys([name] if name else names or ["cam1", "cam2", "cam3", "cam4"], (width, height))
    return out
