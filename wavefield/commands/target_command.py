"""`wavefield target`: calibration targets to print, to scale."""

from pathlib import Path
from typing import TypedDict, Unpack

import click

from wavefield.commands.sources import FILE


class TargetParts(TypedDict):
    """Options of `wavefield target` for one kind of target."""

    marker: float | None  # m, of a ChArUco board
    dictionary: str
    diameter: float | None  # m, of a dot
    rings: bool


_DEFAULT_SHAPES = {"chessboard": (9, 6), "charuco": (10, 7), "dots": (10, 7)}
_PAPERS = ("auto", "A4", "A3", "A2", "A1", "A0", "letter", "fit")


def _counts(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[int, int] | None:
    if value is None:
        return None
    try:
        nx, ny = (int(word) for word in value.lower().split("x"))
    except ValueError:
        raise click.BadParameter(f"{value!r}: write how many along x and y, such as 9x6") from None
    return nx, ny


@click.command(
    epilog="""\b
Examples:
  wavefield target chessboard board.pdf                          # 9 x 6 inner corners, 25 mm, A4
  wavefield target charuco board.pdf --mesh 0.04 --marker 0.03   # on the smallest paper that holds it
  wavefield target dots dots.pdf --shape 20x15 --mesh 0.03 --diameter 0.012 --rings --paper fit
"""
)
@click.argument("kind", type=click.Choice(tuple(_DEFAULT_SHAPES)))
@click.argument("output", type=FILE)
@click.option("--mesh", default=0.025, show_default=True, help="Distance between neighbouring nodes, metres.")
@click.option(
    "--shape",
    metavar="NXxNY",
    callback=_counts,
    help="Inner corners of a chessboard, squares of a ChArUco board, dots; by default 9x6, 10x7, 10x7.",
)
@click.option("--marker", type=float, help="ChArUco: side of a marker, metres; by default 0.7 of the mesh.")
@click.option(
    "--dictionary",
    default="DICT_4X4_50",
    show_default=True,
    help="ChArUco: OpenCV's name of the marker dictionary.",
)
@click.option("--diameter", type=float, help="Diameter of a dot, metres; by default half of the mesh.")
@click.option(
    "--rings",
    is_flag=True,
    help="Dots: rings mark the origin and the axes, so that parts may be out of view.",
)
@click.option(
    "--paper",
    type=click.Choice(_PAPERS),
    default="auto",
    show_default=True,
    help="Size of the sheet; `fit`: as large as the target.",
)
def target(
    kind: str,
    output: Path,
    paper: str,
    mesh: float,
    shape: tuple[int, int] | None,
    **parts: Unpack[TargetParts],
) -> None:
    """Write a calibration target to print, to scale, as a PDF.

    Print it at 100 % (not "fit to page"), measure its line of 100 mm, and glue it to a flat, stiff plate.
    Where the line is not 100 mm long, multiply `mesh` by its length over 100 mm.
    """
    from wavefield.atomic_write import OwnFile, atomic
    from wavefield.calibration.target import Target
    from wavefield.figures.target_page import experiment_entry, target_page

    data: dict[str, object] = {"kind": kind, "mesh": mesh, "shape": list(shape or _DEFAULT_SHAPES[kind])}
    if kind == "charuco":
        marker = parts["marker"]
        data |= {"marker": round(0.7 * mesh, 6) if marker is None else marker}
        data |= {"dictionary": parts["dictionary"]}
    if kind == "dots":
        data |= {"diameter": mesh / 2 if parts["diameter"] is None else parts["diameter"]}
        data |= {"origin_mark": "ring"} if parts["rings"] else {}
    elif parts["rings"]:
        raise click.UsageError("--rings is for dots")
    described = Target.from_dict(data)
    figure = target_page(described, paper)
    pdf = OwnFile("a target to print", lambda path: b"(wavefield target)" in path.read_bytes())
    with atomic(output, pdf) as draft:
        figure.savefig(draft, format="pdf", metadata={"Title": "wavefield target", "CreationDate": None})
    width, height = (25.4 * float(inches) for inches in figure.get_size_inches())
    click.echo(f"Wrote {output}, {width:.0f} x {height:.0f} mm.")
    click.echo(
        "Next: print it at 100 %, measure its line of 100 mm, and write into the calibration block: "
        + experiment_entry(described)
    )
