"""Seas without long waves and ordinary ones: does the learned spectrum find waves wherever they are?

    python -m benchmarks.short_waves [--only ROW ...] [--seeds N ...] [--crop 0.3] [--smooth]

Random seas whose waves are all 6 to 8 or 4 to 6 cm long, single waves of 5.5 and 8 cm, a wave of 5.5 cm on
a sea of 2 cm, water at rest, the tank's random sea, and a reference sea (JONSWAP, significant height 5 cm,
peak at 1 Hz, 0.7 to 5.5 Hz). Exact cameras, a part of every sensor at full resolution. Per row: errors of z,
u, v, w in px of 1.8 mm (velocities per frame), their median stated standard uncertainty, the share of nodes
within one and two standard uncertainties and beyond three, the share of nodes where any variable errs
by more than five, and the share of nodes that are flagged as measured. ``--smooth``: of eleven steps in place
of three, and the same of the fields that `wf.smooth` makes of them.
"""

import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from benchmarks.options import parser_of
from benchmarks.results import save_result
from benchmarks.scenes import BRIGHT, FRAMES, Case, draw, reconstruct
from benchmarks.scores import NAMES, Score
from wavefield.measurement import Settings
from wavefield.tank import Scene, Tank
from wavefield.variables import CUBE_DIMS
from wavefield.waves.smooth import INPUTS, smooth

HALF_FIELD = 0.45, 0.35  # of the nodes, metres, where half of every sensor is read out
TRUE = "65-75 % within 1 std"


def band(shortest: float, longest: float, slope: float) -> dict[str, Any]:
    """A sea of waves between two lengths (m) with an rms slope."""
    rms = slope * np.sqrt(shortest * longest) / (2 * np.pi)
    spectrum = {"kind": "power", "peak": 1.0, "exponent": 3.0}
    return {"kind": "random", "rms": rms, "spectrum": spectrum, "shortest": shortest, "longest": longest}


def single(length: float, slope: float) -> dict[str, Any]:
    """One wave of a length (m) and an rms slope."""
    amplitude = np.sqrt(2) * slope * length / (2 * np.pi)
    return {"kind": "single", "wavelength": length, "amplitude": amplitude, "direction": 20.0}


RANDOM: dict[str, Any] = {
    "kind": "random",
    "rms": 0.014,
    "spectrum": {"kind": "power", "peak": 1.0, "exponent": 7},
}
REFERENCE: dict[str, Any] = {
    "kind": "random",
    "rms": 0.0125,
    "spectrum": {"kind": "jonswap", "peak": 1.0},
    "shortest": 0.052,
    "longest": 3.0,
}
SHORT_ON_SEA: dict[str, Any] = {
    "kind": "random",
    "rms": 0.005,
    "spectrum": {"kind": "power", "peak": 1.2, "exponent": 7},
    "shortest": 0.1,
    "added": [{"wavelength": 0.055, "amplitude": np.sqrt(2) * 0.1 * 0.055 / (2 * np.pi), "direction": 20.0}],
}
# row: (sea, what is asked of it)
ROWS: dict[str, tuple[dict[str, Any], str]] = {
    "6-8 cm, slope 0.05": (band(0.06, 0.08, 0.05), f"z .05; {TRUE}"),
    "6-8 cm, slope 0.15": (band(0.06, 0.08, 0.15), f"z .10; {TRUE}"),
    "one of 5.5 cm, slope 0.05": (single(0.055, 0.05), ""),
    "one of 5.5 cm, slope 0.15": (single(0.055, 0.15), "u .09; .5 % beyond 3"),
    "one of 8 cm, slope 0.15": (single(0.08, 0.15), "u .05; .5 % beyond 3"),
    "4-6 cm, slope 0.03": (band(0.04, 0.06, 0.03), "95 % measured; u .03"),
    "5.5 cm on a sea": (SHORT_ON_SEA, ""),
    "rest": ({"kind": "still"}, "z .005"),
    "random": (RANDOM, "z .018-.022; u v w .013 .011 .020"),
    "reference": (REFERENCE, "z .026; u v w .015 .012 .030"),
}


def described(row: str, seed: int, crop: float, frames: int = FRAMES) -> Scene:
    """The scene of a row: a part ``crop`` of every sensor."""
    x, y = (2 * crop * half for half in HALF_FIELD)
    grid = {"x": (-round(x, 2), round(x, 2)), "y": (-round(y, 2), round(y, 2)), "step": 0.01}
    made = Scene.load("full").model_dump() | {"sea": ROWS[row][0], "surface": BRIGHT if row == "rest" else {}}
    made |= {"frames": frames, "seed": seed, "grid": grid, "rig": {"scale": 1.0, "crop": crop}}
    return Scene.model_validate(made)


def smoothed(case: Case, cube: dict[str, NDArray[Any]], depth: float) -> dict[str, NDArray[Any]]:
    """A cube with fields and uncertainties of `wf.smooth`."""
    axes = {
        "y": case.grid.y_nodes,
        "x": case.grid.x_nodes,
        "time": np.arange(len(cube["z"])) / case.frame_rate,
    }
    found = smooth(xr.Dataset({name: (CUBE_DIMS, cube[name]) for name in INPUTS}, axes), depth=depth)
    return cube | {name: found[name].values for name in INPUTS}


def lines(score: Score) -> list[str]:
    """The results of a row, a line each."""

    def columns(values: Sequence[float], form: str) -> str:
        return " ".join(form.format(v) for v in values)

    stated = [float(np.median(np.concatenate(score.std[name]))) for name in NAMES]
    shares = np.array([score.fractions(name) for name in NAMES]).T
    errors = columns([score.rms(n) for n in NAMES], "{:.4f}")
    return [
        f"rms {errors}; stated {columns(stated, '{:.4f}')} (z u v w)",
        f"within 1 std: {columns(shares[0], '{:.0f}')}; 2: {columns(shares[1], '{:.0f}')}; "
        f"beyond 3: {columns(shares[2], '{:.1f}')}; 5 in any: {score.wrong():.1f}; "
        f"measured: {100 * score.measured / max(score.nodes, 1):.1f} %",
    ]


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", default=list(ROWS), choices=list(ROWS), metavar="ROW")
    parser.add_argument("--seeds", nargs="+", type=int, default=[401, 402, 403])
    parser.add_argument("--crop", type=float, default=0.3, help="part of every sensor; 0.5 is half size")
    parser.add_argument("--save", action="store_true", help="write the result for the validation page")
    parser.add_argument("--smooth", action="store_true", help="eleven steps, and those of `wf.smooth`")
    options = parser.parse_args(words)
    rows = []
    for row in options.only:
        began, score, better = time.process_time(), Score(), Score()
        for seed in options.seeds:
            scene = described(row, seed, options.crop, FRAMES + 8 if options.smooth else FRAMES)
            case = draw(scene, Tank(scene).rig)
            cube = reconstruct(case, Settings())
            score.add(case, cube)
            if options.smooth:
                better.add(case, smoothed(case, cube, scene.sea.depth))
        print(f"{row}    asked: {ROWS[row][1]}", flush=True)
        print("".join(f"    {line}\n" for line in lines(score)), end="")
        if options.smooth:
            print("".join(f"    smoothed: {line}\n" for line in lines(better)), end="")
        print(f"    seeds {options.seeds}; CPU {time.process_time() - began:.0f} s", flush=True)
        rows.append([row, *score.cells()])
    if options.save:
        columns = (
            "sea",
            "z",
            "u dt, v dt, w dt",
            "nodes measured",
            "within one standard uncertainty (ideal: 68 %): z, u, v, w",
        )
        save_result("short_waves", columns, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
