"""Accuracy of matching on pairs of particle images, beside other programs.

    python -m benchmarks.matching [--only LETTER ...] [--python PATH] [--save]
    python -m benchmarks.matching --real FOLDER [--python PATH]

Cases are in `matching.yaml`: rms errors of a component in px, 64 px inside the border, errors above 1 px
counted apart. PATH is a Python in which OpenPIV, pivtools or fluidimage are installed; they are run with the
windows that the column names. ``--real`` compares real pairs instead: FOLDER holds the samples of fluidimage
(Karman, Oseen, Jet, wake_legi), and the table has medians of the distance from the other programs' vectors.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from benchmarks import particle_images as images
from benchmarks.programs import PROGRAMS, Vectors, is_installed, vectors_of
from benchmarks.results import parser_of, print_table, save_result
from wavefield.images import read_image
from wavefield.matching import Displacement, MatchSettings, match, prepare

CASES = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
MARGIN = 64  # px
REAL = {
    "Karman 1-2": ("Karman/Images/Karman_01.bmp", "Karman/Images/Karman_02.bmp"),
    "Karman 3-4": ("Karman/Images/Karman_03.bmp", "Karman/Images/Karman_04.bmp"),
    "Oseen": ("Oseen/Images/Oseen_center_01.tif", "Oseen/Images/Oseen_center_02.tif"),
    "Jet 60": ("Jet/Images/c060a.png", "Jet/Images/c060b.png"),
    "Jet 61": ("Jet/Images/c061a.png", "Jet/Images/c061b.png"),
    "wake_legi": ("wake_legi/images/B00001A.png", "wake_legi/images/B00001B.png"),
}


def at_midpoint(d: Displacement) -> Displacement:
    """The displacement whose path has its middle at the lattice: d_mid(x) = d(x - d_mid(x) / 2)."""
    spacing = d.x[1] - d.x[0]
    column, row = np.meshgrid(np.arange(len(d.x)), np.arange(len(d.y)))
    u, v = d.u, d.v
    for _ in range(6):
        at = [row - v / (2 * spacing), column - u / (2 * spacing)]
        u, v = (map_coordinates(field, at, mode="nearest") for field in (d.u, d.v))
    return replace(d, u=u, v=v)


def ours(a: NDArray[Any], b: NDArray[Any], settings: MatchSettings) -> Vectors:
    """Vectors of `wavefield.matching`, an image being prepared once as in a series."""
    first = prepare(a, settings)
    match(first, prepare(b, settings), settings)
    began = time.process_time()
    d = match(first, prepare(b, settings), settings)
    seconds = time.process_time() - began
    d = at_midpoint(d)
    return Vectors(*np.meshgrid(d.x, d.y), d.u, d.v, seconds)


def errors(found: Vectors, field: images.Field) -> str:
    """The rms error of a component, and how many vectors are off by more than a pixel."""
    u, v = field(found.x, found.y)
    ends = [axis + sign * part / 2 for axis, part in ((found.x, u), (found.y, v)) for sign in (-1, 1)]
    last = images.N - 1 - MARGIN
    inside = np.all([(end >= MARGIN) & (end <= last) for end in ends], axis=0)
    # programs count v up or down, and one counts the first image against the second
    signs = [(s, t) for s in (1, -1) for t in (1, -1)]
    size = min(
        (np.hypot(s * found.u - u, t * found.v - v)[inside] for s, t in signs),
        key=lambda error: float(np.nanmedian(error)),
    )
    good = size < 1
    outliers = f" ({np.sum(~good)} of {size.size})" if not good.all() else ""
    return f"{np.sqrt(np.mean(size[good] ** 2) / 2):.3f}{outliers}"


def accuracy(python: str | None, only: Sequence[str]) -> tuple[list[str], list[list[str]]]:
    """Columns and rows of the table of simulated pairs."""
    others = [name for name in PROGRAMS if python and is_installed(name, python)]
    spent: dict[str, list[Vectors]] = {}
    rows = []
    for label, given in CASES.items():
        if only and label[0] not in only:
            continue
        options = dict(given)
        name, *numbers = options.pop("field")
        preset = options.pop("preset", "piv")
        field = getattr(images, name)(*numbers)
        a, b = images.particles(field, **options)
        cells = [label]
        found: dict[str, Vectors | str] = {"wavefield": ours(a, b, getattr(MatchSettings, preset)())}
        if python and preset == "piv":
            found |= {program: vectors_of(program, python, a, b) for program in others}
        for program in ("wavefield", *others):
            vectors = found.get(program, "")
            cells.append(vectors if isinstance(vectors, str) else errors(vectors, field))
            if not isinstance(vectors, str):
                spent.setdefault(program, []).append(vectors)
        rows.append(cells)
        print(" | ".join(cells), file=sys.stderr, flush=True)
    least = {name: min(each, key=lambda one: one.seconds) for name, each in spent.items()}
    for label, text in (
        ("CPU time of a pair, s", lambda one: f"{one.seconds:.2f}"),
        ("vectors of a pair", lambda one: f"{one.u.size}"),
    ):
        rows.append([label, *(text(least[name]) if name in least else "" for name in ("wavefield", *others))])
    return ["pair", "wavefield", *others], rows


def real(folder: Path, python: str) -> tuple[list[str], list[list[str]]]:
    """Columns and rows of the table of real pairs."""
    others = [name for name in PROGRAMS if is_installed(name, python)]
    rows = []
    for label, files in REAL.items():
        a, b = (read_image(folder / file) for file in files)
        d = match(a, b, None)
        found = [vectors_of(program, python, a, b) for program in others]
        distances = [one if isinstance(one, str) else f"{apart(d, one):.2f}" for one in found]
        rows.append([label, f"{100 * d.valid.mean():.1f} %", *distances])
    return ["pair", "valid", *(f"median distance from {name}, px" for name in others)], rows


def apart(d: Displacement, found: Vectors) -> float:
    """Median distance of the vectors, where ours are valid."""
    at = [(found.y - d.y[0]) / (d.y[1] - d.y[0]), (found.x - d.x[0]) / (d.x[1] - d.x[0])]
    fields = (d.u, d.v, d.valid)
    u, v, valid = (map_coordinates(field.astype(float), at, order=1, mode="nearest") for field in fields)
    good = (valid > 0.999) & np.isfinite(found.u + found.v)
    signs = [(s, t) for s in (1, -1) for t in (1, -1)]
    return min(float(np.median(np.hypot(u - s * found.u, v - t * found.v)[good])) for s, t in signs)


def main(words: Sequence[str]) -> int:
    cv2.setNumThreads(1)
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", default=[], help="letters of cases")
    parser.add_argument("--python", help="where other programs are installed")
    parser.add_argument("--real", type=Path, help="folder of the samples of fluidimage")
    options = parser.parse_args(words)
    if options.real:
        print_table(*real(options.real, options.python or sys.executable))
        return 0
    columns, rows = accuracy(options.python, options.only)
    print_table(columns, rows)
    if options.save:
        save_result("matching", columns, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
