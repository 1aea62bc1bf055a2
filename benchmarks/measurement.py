"""Errors of the measurement on simulated and path-traced images, against the exact answer.

    python -m benchmarks.measurement [--only ROW ...] [--seeds N ...] [--full] [--exact] [--set FILE.yaml]

Rows: random, light, steep, low_light, gaps, rest, texture, noisy (simulated; three seeds by default), tank,
glare, tank_small (path-traced images, where there are any: see `benchmarks.path_traced`).

1 px = 1.8 mm; nodes 4 cm inside the edge of the common view that are called measured; steps with two
frames on either side; u dt, v dt, w dt against the water's own, instantaneous velocity. The rig is calibrated
from simulated images of the target (``--exact``: the exact cameras). By default the middle half of every
sensor at full resolution; ``--full``: the paper's whole field.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks import path_traced
from benchmarks.options import parser_of
from benchmarks.results import save_result
from benchmarks.scenes import FRAMES, SCENES, SEEDS, Case, calibrated, draw, inside, reconstruct, scene
from benchmarks.scores import Score, rms
from wavefield.measurement import Settings
from wavefield.tank import Tank
from wavefield.waves.motion import terms

# asked of each row: rms of u and v, of w, of z; per cent within 1 and 2 std; beyond 3
TRUE = "63-75, 93-98, .5 %"
ASKED = {
    "random": f"u v .009; w .016; z .026; {TRUE}",
    "light": f"u v .009; w .016; z .026; {TRUE}",
    "steep": f"u v .009, bias .002; w .020; z .036; {TRUE}",
    "low_light": f"u v .035; w .068; z .045; {TRUE}",
    "gaps": f"u v .015; w .030; z .034; {TRUE}; filled .22, .35, .30; 60, 90, 3 %",
    "rest": "u v .005; w .010; z .010; 60-80, 92-99",
    "texture": "u v .010; w .010; z .010",
    "noisy": "",
    "tank": "u v .014; w .016; z .026; 63-75, 93-98, 1 %",
    "glare": "98.5 % measured; u v .018; w .035; z .045; 63-75, 93-98, 1 %",
    "tank_small": "99.5 % measured; u v .035; w .055; z bias apart .05; 60, 90, 2 %",
}
LABELS = {  # on the validation page
    "random": "random sea, 1.4 cm rms",
    "light": "the same, one camera five times darker than another, flicker of 30 %",
    "steep": "steep sea, slopes beyond 0.3",
    "low_light": "poor light: beads 45 grey levels over a background of 30, read noise 7",
    "gaps": "eight gaps of 3 to 8 cm radius, clustered beads",
    "noisy": "twice the noise, 10 % of the beads visible to one camera only",
    "texture": "painted texture on a wave of 3 cm",
    "rest": "still water",
    "tank": "path-traced beads, lit from the side",
    "glare": "path-traced beads and glare",
    "tank_small": "path-traced small beads, two frames only",
}
COLUMNS = (
    "images",
    "z",
    "u dt, v dt, w dt",
    "nodes measured",
    "within one standard uncertainty (ideal: 68 %): z, u, v, w",
)
RESIDUAL = {"random": "; residual .08", "steep": "; residual .04"}


def residual(case: Case, cube: dict[str, Any]) -> tuple[float, float]:
    """Stored z_t - w + u . grad z over the nonlinear term, rms: measured, and of the exact fields."""
    exact = {name: np.array([truth[name] for truth in case.truth]) for name in ("u", "v")}
    exact["z"] = exact["mean"] = np.array([0.5 * (t["z_start"] + t["z_end"]) for t in case.truth])
    exact["z_t"] = np.array([t["z_t"] for t in case.truth])
    exact["w"] = np.array([t["w_chord"] for t in case.truth])
    core = inside(case, case.truth[0]["z"], 0.07)
    found = []
    for fields in (cube, exact):
        fields = {k: np.nan_to_num(fields[k]).astype(np.float64) for k in ("z", "z_t", "u", "v", "w")}
        parts = terms(fields | {"mean": fields["z"]}, case.grid.step, case.grid.step)
        found.append(rms(parts["residual"][:, core]) / rms(parts["nonlinear"][:, core]))
    return found[0], found[1]


def cases(name: str, options: argparse.Namespace) -> Iterator[Case]:
    """The cases of a simulated row, one per seed."""
    for seed in options.seeds:
        described = scene(name, seed, options.full)
        yield draw(described, Tank(described).rig if options.exact else calibrated(options.full))


def compare(name: str, options: argparse.Namespace, settings: Settings) -> tuple[dict[str, Score], list[str]]:
    """Measure a row: its score and its results in words."""
    score, shares, steepest = Score(), [], 0.0
    began = time.process_time()
    for case in cases(name, options):
        cube = reconstruct(case, settings)
        score.add(case, cube)
        slope = np.hypot(*np.gradient(case.truth[0]["z"], case.grid.step))
        steepest = max(steepest, float(slope[inside(case, case.truth[0]["z"])].max()))
        if name in RESIDUAL:
            shares.append(residual(case, cube))
    lines = score.lines()
    if shares:
        measured, exact = np.mean(shares, axis=0)
        lines.append(f"residual over nonlinear term {measured:.3f}; of exact fields {exact:.3f}")
    took = time.process_time() - began
    return {"": score}, [
        *lines,
        f"largest slope {steepest:.2f}; {len(options.seeds)} seeds; CPU {took:.0f} s",
    ]


def read_options(words: Sequence[str]) -> argparse.Namespace:
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", default=list(ASKED), choices=list(ASKED), metavar="ROW")
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    parser.add_argument("--full", action="store_true", help="the paper's whole field")
    parser.add_argument("--exact", action="store_true", help="exact cameras instead of calibrated ones")
    parser.add_argument("--save", action="store_true", help="write the result for the validation page")
    parser.add_argument("--set", type=Path, help="YAML of measurement settings that differ")
    return parser.parse_args(words)


def main(words: Sequence[str]) -> int:
    options = read_options(words)
    changed = yaml.safe_load(options.set.read_text()) if options.set else {}
    settings = Settings.from_dict(changed)
    size = "full size" if options.full else "half size"
    print(f"1 px = 1.8 mm; {size}; {FRAMES} frames of each scene, seeds {options.seeds}", flush=True)
    rows = []
    for name in options.only:
        scores: dict[str, Score] = {}
        if name in SCENES:
            scores, lines = compare(name, options, settings)
        elif path_traced.folder() is None:
            lines = ["skipped: no path-traced images (set WAVEFIELD_SHARED)"]
        else:
            scores, lines = path_traced.compare(name, settings)
        print(f"{name}\n    asked: {ASKED[name]}{RESIDUAL.get(name, '')}", flush=True)
        print("".join(f"    {line}\n" for line in lines), end="", flush=True)
        rows += [[LABELS[name] + words, *score.cells()] for words, score in scores.items()]
        if name == "gaps":
            rows.append(["the filled nodes of these gaps", *scores[""].cells(filled=True)])
    if options.save:
        save_result("measurement", COLUMNS, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
