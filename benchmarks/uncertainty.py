"""The terms of the standard uncertainties beside the errors that were made, scene by scene.

    python -m benchmarks.uncertainty [--only ROW ...] [--seeds N ...] [--figure FILE.svg]

Rows: simulated scenes of `benchmarks.measurement` and short seas of `benchmarks.short_waves`, half size or
less, three steps. Per row and variable: the rms error, the rms of every term of `wf.uncertainty_terms`, px of
1.8 mm (velocities times the step's length), and the share of nodes within one standard uncertainty.
``--figure`` draws the variances of z and w as bars beside the squared errors.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import short_waves
from benchmarks.options import parser_of
from benchmarks.scenes import PIXEL, SCENES, Case, calibrated, draw, inside, scene
from benchmarks.scores import NAMES, rms
from wavefield.measurement import GridGeometry, Settings, measure
from wavefield.measurement.error_budget import TERMS
from wavefield.tank import Tank
from wavefield.variables import Quality

SHORT = {"short seas, slope .05": "6-8 cm, slope 0.05", "short seas, slope .15": "6-8 cm, slope 0.15"}
ROWS = ("random", "steep", "low_light", "gaps", "texture", "rest", *SHORT)
COLORS = ("#8a8f98", "#1f5f99", "#c8553d", "#7a5195", "#3c8d5a")


def case(row: str, seed: int) -> Case:
    """Frames and truth of a row."""
    if row in SCENES:
        return draw(scene(row, seed), calibrated(False))
    described = short_waves.described(SHORT[row], seed, 0.4)
    return draw(described, Tank(described).rig)


def compared(one: Case) -> tuple[NDArray[Any], NDArray[Any]]:
    """Errors (4, n) and terms (terms, 4, n) of the nodes that are flagged as measured, px."""
    geometry = GridGeometry(one.rig, one.grid, Settings())
    cube = measure(one.frames, geometry, one.frame_rate, terms=True)
    errors, terms = [], []
    for step, truth in enumerate(one.truth):
        here = inside(one, truth["z"]) & ((cube["quality"][step] & Quality.MEASURED) > 0)
        scale = [1.0, *[1.0 / one.frame_rate] * 3]
        errors.append([k * (cube[n][step] - truth[n])[here] / PIXEL for n, k in zip(NAMES, scale)])
        terms.append(cube["uncertainty_terms"][step][..., here] / PIXEL)
    return np.concatenate(errors, axis=1), np.concatenate(terms, axis=2)


def bars(found: dict[str, tuple[NDArray[Any], NDArray[Any]]], path: Path) -> None:
    """Draw the variances of z and w of every row, as shares of the stated variance."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 3.2), layout="constrained")
    for axes, (n, name) in zip(figure.subplots(1, 2, sharey=True), ((0, "z"), (3, "w"))):
        stated = [np.square(terms[:, n]).mean(axis=1) for _, terms in found.values()]
        left = np.zeros(len(stated))
        for m, term in enumerate(TERMS):
            width = np.array([one[m] / one.sum() for one in stated])
            axes.barh(list(found), width, 0.6, left, color=COLORS[m], label=term)
            left += width
        made = [np.square(rms(errors[n])) / one.sum() for (errors, _), one in zip(found.values(), stated)]
        axes.plot(made, list(found), "k|", ms=14, mew=2, label="squared error")
        axes.set(title=name, xlabel="part of the stated variance")
        axes.spines[["top", "right"]].set_visible(False)
        axes.invert_yaxis()
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    figure.savefig(path, metadata={"Date": None})


def read_options(words: Sequence[str]) -> argparse.Namespace:
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", default=list(ROWS), choices=ROWS, metavar="ROW")
    parser.add_argument("--seeds", nargs="+", type=int, default=[81])
    parser.add_argument("--figure", type=Path, help="SVG to draw")
    return parser.parse_args(words)


def main(words: Sequence[str]) -> int:
    options = read_options(words)
    found = {}
    print(f"px of 1.8 mm; seeds {options.seeds}; terms {', '.join(TERMS)}", flush=True)
    for row in options.only:
        each = [compared(case(row, seed)) for seed in options.seeds]
        errors, terms = (np.concatenate(part, axis=-1) for part in zip(*each))
        found[row] = errors, terms
        print(row)
        for n, name in enumerate(NAMES):
            parts = " ".join(f"{rms(one[n]):.4f}" for one in terms)
            std = np.sqrt(np.square(terms[:, n]).sum(axis=0))
            share = 100.0 * np.mean(np.abs(errors[n]) < std)
            print(f"    {name}: error {rms(errors[n]):.4f}; {parts}; within one {share:.0f} %", flush=True)
    if options.figure:
        bars(found, options.figure)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
