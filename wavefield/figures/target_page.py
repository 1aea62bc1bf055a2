"""Calibration targets to print, to scale: chessboards, ChArUco boards and grids of dots."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from numpy.typing import NDArray

from wavefield.calibration.target import Target
from wavefield.errors import CalibrationError

Rectangle = tuple[float, float, float, float]  # x, y, width, height, mm

MM_PER_INCH = 25.4
MARGIN = 8.0  # mm, of a page: printers leave it white
CAPTION = 14.0  # mm, below the board
SCALE_LINE = 100.0  # mm
HOLE = 0.5  # of a ring's diameter
PAPERS = {"A4": (210.0, 297.0), "letter": (215.9, 279.4)} | {
    f"A{k}": (round(841 / 2 ** (k / 2)), round(1189 / 2 ** (k / 2))) for k in (3, 2, 1, 0)
}


@dataclass
class Shapes:
    """What is black and what is white again within a board, mm from its upper left corner, y downwards."""

    width: float
    height: float
    black: list[Rectangle] = field(default_factory=list)
    white: list[Rectangle] = field(default_factory=list)
    dots: list[tuple[float, float, float]] = field(default_factory=list)  # x, y, diameter
    holes: list[tuple[float, float, float]] = field(default_factory=list)  # white discs, in dots


def target_shapes(target: Target) -> Shapes:
    """The board of a target, mm; its node (0, 0) is the lower left one, or the ring at the right angle.
    CalibrationError if no target of this kind can be printed.
    """
    if target.shape is None or target.kind not in ("chessboard", "charuco", "dots"):
        raise CalibrationError(
            f"a target of kind {target.kind} cannot be printed; use chessboard, charuco or dots"
        )
    mesh = 1e3 * target.mesh
    nx, ny = target.shape
    if target.kind == "dots":
        diameter = 1e3 * (target.diameter or target.mesh / 2)
        edge = mesh  # white around the outer dots' centres
        out = Shapes((nx - 1) * mesh + 2 * edge, (ny - 1) * mesh + 2 * edge)
        out.dots = [(edge + i * mesh, edge + j * mesh, diameter) for j in range(ny) for i in range(nx)]
        if target.origin_mark == "ring":
            i, j = nx // 2 - 1, ny // 2 - 1
            out.holes = [
                (edge + a * mesh, edge + (ny - 1 - b) * mesh, HOLE * diameter)
                for a, b in ((i, j), (i + 2, j), (i, j + 1))
            ]
        return out
    if target.kind == "chessboard":
        out = Shapes((nx + 1) * mesh, (ny + 1) * mesh)
        # the square between nodes (0, 0) and (1, 1) is dark
        dark = [(i, j) for j in range(ny + 1) for i in range(nx + 1) if (i + ny - j) % 2 == 0]
        out.black = [(i * mesh, j * mesh, mesh, mesh) for i, j in dark]
        return out
    return _charuco(target, nx, ny, mesh)


def _charuco(target: Target, nx: int, ny: int, mesh: float) -> Shapes:
    code = getattr(cv2.aruco, target.dictionary, None)
    if not isinstance(code, int):
        raise CalibrationError(
            f"marker dictionary {target.dictionary!r} is unknown; use DICT_4X4_50 or another"
        )
    dictionary = cv2.aruco.getPredefinedDictionary(code)
    marker = 1e3 * float(target.marker or 0.0)
    board = cv2.aruco.CharucoBoard((nx, ny), mesh, marker, dictionary)
    corners = np.asarray(board.getObjPoints(), float)[:, 0, :2]  # upper left ones of the markers
    numbers = np.asarray(board.getIds()).ravel()
    if numbers.max() >= len(dictionary.bytesList):
        raise CalibrationError(
            f"{target.dictionary} has {len(dictionary.bytesList)} markers, but {nx} x {ny} squares need "
            f"{len(numbers)}; choose a larger dictionary, such as DICT_4X4_250, or fewer squares"
        )
    out = Shapes(nx * mesh, ny * mesh)
    light = {(int(x // mesh), int(y // mesh)) for x, y in corners}
    out.black = [
        (i * mesh, j * mesh, mesh, mesh) for j in range(ny) for i in range(nx) if (i, j) not in light
    ]
    cells = dictionary.markerSize + 2  # with the black border
    cell = marker / cells
    for (x, y), number in zip(corners, numbers):
        out.black.append((x, y, marker, marker))
        bits = dictionary.generateImageMarker(int(number), cells) > 127
        for row, column, length in _runs(bits):
            out.white.append((x + column * cell, y + row * cell, length * cell, cell))
    return out


def _runs(bits: NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """Row, first column and length of the runs of True."""
    out = []
    for row, line in enumerate(bits):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(int), [0]])))
        out += [(row, int(a), int(b - a)) for a, b in zip(edges[::2], edges[1::2])]
    return out


def page_size(shapes: Shapes, paper: str = "auto") -> tuple[float, float]:
    """Width and height of the page, mm: the smallest of A4 to A0 that holds the board, if none is named.
    CalibrationError if the board is larger than the paper.
    """
    needed = shapes.width + 2 * MARGIN, shapes.height + CAPTION + 2 * MARGIN
    if paper == "fit":
        return max(needed[0], SCALE_LINE + 2 * MARGIN), needed[1]
    for name in ("A4", "A3", "A2", "A1", "A0") if paper == "auto" else (paper,):
        for width, height in (PAPERS[name], PAPERS[name][::-1]):
            if needed[0] <= width and needed[1] <= height:
                return width, height
    largest = "A0" if paper == "auto" else paper
    raise CalibrationError(
        f"a board of {shapes.width:.0f} x {shapes.height:.0f} mm does not fit {largest}"
        "; choose a smaller mesh or shape, or --paper fit for a page of its size"
    )


def target_page(target: Target, paper: str = "auto") -> Figure:
    """A page with a target to print, to scale; a line of 100 mm shows whether it was printed so.
    paper: A4 to A0, letter, ``auto`` (the smallest of A4 to A0) or ``fit`` (as large as the board).
    """
    shapes = target_shapes(target)
    width, height = page_size(shapes, paper)
    left = (width - shapes.width) / 2
    top = (height - CAPTION - shapes.height) / 2
    figure = Figure(figsize=(width / MM_PER_INCH, height / MM_PER_INCH))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    for rectangles, colour in ((shapes.black, "black"), (shapes.white, "white")):
        moved = [(left + x, top + y, w, h) for x, y, w, h in rectangles]
        _fill(axes, moved, colour)
    for discs, colour in ((shapes.dots, "black"), (shapes.holes, "white")):
        if not discs:
            continue
        x, y, diameter = np.array(discs).T
        axes.add_collection(
            EllipseCollection(
                diameter, diameter, np.zeros_like(x), units="xy", offsets=np.stack([left + x, top + y], -1),
                offset_transform=axes.transData, facecolors=colour, edgecolors="none",
            ),
            autolim=False,
        )  # fmt: skip
    _add_caption(figure, target, width, height)
    return figure


def _fill(axes: Axes, rectangles: Sequence[Rectangle], colour: str) -> None:
    """Fill rectangles, as one path: all corners are in the file as they are."""
    if rectangles:
        corners = [Path([(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)], closed=True)
                   for x, y, w, h in rectangles]  # fmt: skip
        axes.add_patch(
            PathPatch(Path.make_compound_path(*corners), facecolor=colour, linewidth=0, snap=False)
        )


def _add_caption(figure: Figure, target: Target, width: float, height: float) -> None:
    """The line that shows the scale, and what the target is."""
    axes = figure.axes[0]
    line, start = height - MARGIN, (width - SCALE_LINE) / 2
    bars = [(start, line - 0.3, SCALE_LINE, 0.3)]
    bars += [(x, line - 2, 0.3, 2.0) for x in (start, start + SCALE_LINE - 0.3)]
    _fill(axes, bars, "black")
    words = f"{experiment_entry(target)}   Print at 100 %: the line below is 100 mm."
    size = min(8.0, 8.0 * (width - 2 * MARGIN) / 190.0)
    axes.text(width / 2, line - 3, words, ha="center", va="bottom", fontsize=size)


def experiment_entry(target: Target) -> str:
    """The target as the experiment file describes it.

    Examples
    --------
    >>> experiment_entry(Target("chessboard", mesh=0.025, shape=(9, 6)))
    'target: {kind: chessboard, mesh: 0.025, shape: [9, 6]}'
    """
    more = ""
    if target.kind == "charuco":
        more = f", marker: {target.marker:g}, dictionary: {target.dictionary}"
    if target.kind == "dots":
        more = f", diameter: {target.diameter or target.mesh / 2:g}"
        more += ", origin_mark: ring" if target.origin_mark == "ring" else ""
    nx, ny = target.shape or (0, 0)
    return f"target: {{kind: {target.kind}, mesh: {target.mesh:g}, shape: [{nx}, {ny}]{more}}}"
