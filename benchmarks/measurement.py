"""Errors of the measurement on simulated and path-traced images, against the exact answer.

    python -m benchmarks.measurement [TABLE] [--only TEXT ...] [--seeds N ...] [--set FILE.yaml] [--save]
    python -m benchmarks.measurement --terms [--only TEXT ...] [--seeds N ...] [--figure FILE.svg] [--save]
    python -m benchmarks.measurement --bound [--seeds N ...] [--save]

Tables and their cases are in `measurement.yaml`: measurement, short_waves, cameras, records, smoothing.
``--only`` chooses the rows whose label contains one of the texts. Errors are rms in px of 1.8 mm over nodes 4
cm inside the edge of the common view that are flagged as measured; u dt, v dt, w dt are compared with the
water's own, instantaneous velocity. ``--terms`` puts the terms of `wavefield.uncertainty_terms` beside the
errors; ``--bound`` compares the random sea with the Cramer-Rao bound and with a rule for digital image
correlation.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import xarray as xr
import yaml
from numpy.typing import NDArray

from benchmarks import path_traced
from benchmarks.results import parser_of, print_table, save_result
from benchmarks.scenes import (
    FRAMES,
    MIDDLE,
    NAMES,
    PIXEL,
    Case,
    Score,
    calibrated,
    draw,
    inside,
    reconstruct,
    rms,
    scene,
)
from wavefield.measurement import GridGeometry, Settings, measure
from wavefield.measurement.error_budget import TERMS
from wavefield.rig import Rig
from wavefield.tank import Scene, Tank
from wavefield.variables import CUBE_DIMS, Quality
from wavefield.waves.smooth import INPUTS, smooth

TABLES = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
OWN = {
    "scene", "waves", "wave", "slope", "crop", "exact", "frames", "only_cameras", "missing", "shake",
    "stamps", "filled", "smooth", "path_traced", "bead_height",
}  # fmt: skip
COLUMNS = (
    "z",
    "u dt, v dt, w dt",
    "nodes measured",
    "within one standard uncertainty (ideal: 68 %): z, u, v, w",
    "beyond five",
)
TERM_SCENES = ("random", "steep", "low_light", "gaps", "texture", "rest")
TERM_COLUMNS = ("scene", *(f"{n}: {what}" for n in "zw" for what in ("error", "terms", "within one")))
COLORS = ("#8a8f98", "#1f5f99", "#c8553d", "#7a5195", "#3c8d5a")

SHORTEST = 0.05  # m, of the random sea
DARK = {"read_noise": 0.0, "shot_noise": 0.0}
# a rule of VIC-3D's makers: field / 100,000 in the plane and field / 50,000 out of it
RULE = {"z": 50_000, "u": 100_000, "v": 100_000, "w": 50_000}
BOUND_COLUMNS = ("", "error, px", "Cramer-Rao bound, px", "error over bound", "VIC-3D's rule, px")

Row = Mapping[str, Any]


def sea(row: Row) -> dict[str, Any]:
    """The sea of a row with a band of waves, or one wave, of an rms slope."""
    if "wave" in row:
        amplitude = np.sqrt(2) * row["slope"] * row["wave"] / (2 * np.pi)
        return {"kind": "single", "wavelength": row["wave"], "amplitude": amplitude, "direction": 20.0}
    shortest, longest = row["waves"]
    return {
        "kind": "random",
        "rms": row["slope"] * np.sqrt(shortest * longest) / (2 * np.pi),
        "spectrum": {"kind": "power", "peak": 1.0, "exponent": 3.0},
        "shortest": shortest,
        "longest": longest,
    }


def described(row: Row, seed: int) -> Scene:
    """The simulated scene of a row."""
    changes = {key: value for key, value in row.items() if key not in OWN}
    changes["frames"] = row.get("frames", FRAMES)
    made = scene(row.get("scene", "random"), seed, row.get("crop", 0.5), **changes)
    if "wave" in row or "waves" in row:
        made = Scene.model_validate(made.model_dump() | {"sea": sea(row)})
    return made


def drawn(row: Row, seed: int) -> Case:
    """Frames and truth of a row."""
    made = described(row, seed)
    case = draw(made, made.build_rig() if row.get("exact") else calibrated())
    frames = {name: list(case.frames[name]) for name in row.get("only_cameras", case.frames)}
    draws = np.random.default_rng(seed)
    for name, px in row.get("shake", {}).items():
        frames[name] = [moved(image, draws.normal(0.0, px)) for image in frames[name]]
    if "missing" in row:
        frames[row["missing"]][MIDDLE] = None
    rig = Rig({name: case.rig[name] for name in frames}) if "only_cameras" in row else case.rig
    return replace(case, frames=frames, rig=rig)


def moved(image: Any, px: float) -> NDArray[Any]:
    """An image moved along its rows, by Lanczos' interpolation."""
    shift = np.array([[1.0, 0.0, px], [0.0, 1.0, 0.0]])
    size = image.shape[::-1]
    return cv2.warpAffine(image, shift, size, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)


def smoothed(case: Case, cube: dict[str, NDArray[Any]], depth: float) -> dict[str, NDArray[Any]]:
    """A cube with fields and uncertainties of `wavefield.smooth`."""
    time_axis = np.arange(len(cube["z"])) / case.frame_rate
    axes = {"y": case.grid.y_nodes, "x": case.grid.x_nodes, "time": time_axis}
    found = smooth(xr.Dataset({name: (CUBE_DIMS, cube[name]) for name in INPUTS}, axes), depth=depth)
    return cube | {name: found[name].values for name in INPUTS}


def measured(row: Row, seed: int, settings: Settings) -> tuple[Case, dict[str, NDArray[Any]]]:
    """A case of a row and its cube."""
    case, made = drawn(row, seed), described(row, seed)
    late = None
    if row.get("stamps"):
        numbers = range(made.frames)
        late = np.array([made.frame_time(k) - made.time(k) for k in numbers]) * case.frame_rate
    cube = reconstruct(case, settings, late)
    if row.get("smooth"):
        cube = smoothed(case, cube, made.sea.depth)
    if "missing" in row:
        step = slice(MIDDLE - 2, MIDDLE - 1)
        case, cube = (
            replace(case, truth=case.truth[step]),
            {name: field[step] for name, field in cube.items()},
        )
    return case, cube


def score_of(row: Row, seeds: Sequence[int], settings: Settings) -> Score | None:
    """Errors of a row over all seeds; None where its path-traced images are not here."""
    score = Score()
    if "path_traced" in row:
        if path_traced.folder() is None:
            return None
        case = path_traced.load(row["path_traced"])
        height = path_traced.bead_height() if row.get("bead_height") else None
        score.add(
            case, reconstruct(case, settings if height is None else replace(settings, bead_height=height))
        )
        return score
    for seed in seeds:
        score.add(*measured(row, seed, settings))
    return score


def rows_of(table: Mapping[str, Any], only: Sequence[str]) -> Iterator[tuple[str, Row]]:
    """Labels and keys of the rows that are asked for."""
    common = {key: value for key, value in table.items() if key not in ("first", "seeds", "cases")}
    for label, own in table["cases"].items():
        if not only or any(text in label for text in only):
            yield label, common | own


def compare(options: argparse.Namespace) -> None:
    """Measure the rows of a table."""
    table = TABLES[options.table]
    settings = Settings.from_dict(yaml.safe_load(options.set.read_text()) if options.set else {})
    columns, rows = (table["first"], *COLUMNS), []
    for label, row in rows_of(table, options.only):
        began = time.process_time()
        score = score_of(row, options.seeds or table["seeds"], settings)
        if score is None:
            print(f"{label}: skipped, no path-traced images (set WAVEFIELD_SHARED)", file=sys.stderr)
            continue
        rows.append([label, *score.cells(bool(row.get("filled")))])
        print(f"{label}: CPU {time.process_time() - began:.0f} s; {score}", file=sys.stderr, flush=True)
    print_table(columns, rows)
    if options.save:
        save_result(options.table, columns, rows)


def error_and_terms(case: Case) -> tuple[NDArray[Any], NDArray[Any]]:
    """Errors (4, n) and terms (terms, 4, n) of the nodes that are flagged as measured, px."""
    cube = measure(case.frames, GridGeometry(case.rig, case.grid, Settings()), case.frame_rate, terms=True)
    errors, terms = [], []
    for step, truth in enumerate(case.truth):
        here = inside(case, truth["z"]) & ((cube["quality"][step] & Quality.MEASURED) > 0)
        scale = [1.0, *[1.0 / case.frame_rate] * 3]
        errors.append([k * (cube[n][step] - truth[n])[here] / PIXEL for n, k in zip(NAMES, scale)])
        terms.append(cube["uncertainty_terms"][step][..., here] / PIXEL)
    return np.concatenate(errors, axis=1), np.concatenate(terms, axis=2)


def show_terms(options: argparse.Namespace) -> None:
    """Terms of the standard uncertainties beside the errors, scene by scene."""
    found, rows = {}, []
    for name in options.only or TERM_SCENES:
        seeds = options.seeds or [81]
        each = [error_and_terms(drawn({"scene": name}, seed)) for seed in seeds]
        errors, terms = found[name] = tuple(np.concatenate(part, axis=-1) for part in zip(*each))
        cells = [name]
        for n in (0, 3):
            std = np.sqrt(np.square(terms[:, n]).sum(axis=0))
            parts = " ".join(f"{rms(one[n]):.4f}" for one in terms)
            share = f"{100.0 * np.mean(np.abs(errors[n]) < std):.0f} %"
            cells += [f"{rms(errors[n]):.4f}", parts, share]
        rows.append(cells)
    print(f"terms: {', '.join(TERMS)}")
    print_table(TERM_COLUMNS, rows)
    if options.figure:
        draw_terms(found, options.figure)
    if options.save:
        save_result("terms", TERM_COLUMNS, rows)


def draw_terms(found: Mapping[str, Any], path: Path) -> None:
    """Bars of the variances of z and w as parts of the stated variance, with the squared errors."""
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


def bound(described: Scene) -> NDArray[np.float64]:
    """Cramer-Rao bounds of z in the middle of a step and of the displacement, standard deviations, m, (4,).

    They are those of an unbiased estimate from the two frames of a step, where every independent area of the
    surface has a texture of its own, unknown and common to all cameras and both frames, and images have white
    noise. An independent area is lambda^2 / pi, lambda being the shortest wave of the sea. The measurement
    uses more frames and the spectrum of the waves, so that it may fall below this bound.
    """
    noisy, exact = Tank(described).render(3), Tank(described.with_(light=DARK)).render(3)
    known, mean, weights = np.zeros((4, 4)), np.zeros((2, 4)), 0.0
    gradients = []
    shifts, weight = [], []
    for name, camera in Tank(described).rig.cameras.items():
        image = np.asarray(exact[name], float)
        variance = float(np.var(np.asarray(noisy[name], float) - image))
        slopes = np.stack(np.gradient(image)[::-1]).reshape(2, -1)  # along columns, rows
        J = camera.jacobian(0.0, 0.0, 0.0)
        plane, rise = J[:, :2], J[:, 2]
        gradients.append(plane.T @ (slopes @ slopes.T / slopes.shape[1]) @ plane)
        parallax = np.linalg.solve(plane, rise)
        for frame in (0, 1):  # by how much z, dx, dy, dz move the texture in the plane
            shifts.append(np.column_stack([parallax, frame * np.eye(2), frame * parallax]))
            weight.append(abs(np.linalg.det(plane)) / variance)  # pixels per m2 over the noise
    G = np.mean(gradients, axis=0)
    for S, w in zip(shifts, weight, strict=True):
        known += w * S.T @ G @ S
        mean += w * S
        weights += w
    information = known - mean.T @ G @ mean / weights  # the texture itself is unknown
    covariance = np.linalg.inv(information * SHORTEST**2 / np.pi)
    middle = np.eye(4)
    middle[0, 3] = 0.5
    return np.sqrt(np.diag(middle @ covariance @ middle.T))


def show_bound(seeds: list[int], save: bool) -> None:
    """Print the errors of the random sea, their bounds and the rule."""
    score = Score()
    for seed in seeds:
        case = draw(scene("random", seed), calibrated())
        score.add(case, reconstruct(case, Settings()))
    least = bound(scene("random", seeds[0])) / PIXEL
    field = np.ptp(case.grid.x_nodes) / PIXEL
    rows = []
    for name, limit in zip(NAMES, least, strict=True):
        label = name if name == "z" else f"{name} dt"
        error, rule = score.rms(name), field / RULE[name]
        rows.append([label, f"{error:.3f}", f"{limit:.3f}", f"{error / limit:.1f}", f"{rule:.3f}"])
    print_table(BOUND_COLUMNS, rows)
    if save:
        save_result("bound", BOUND_COLUMNS, rows)


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("table", nargs="?", default="measurement", choices=list(TABLES))
    parser.add_argument("--only", nargs="+", default=[], metavar="TEXT", help="rows that contain a text")
    parser.add_argument("--seeds", nargs="+", type=int)
    parser.add_argument("--set", type=Path, help="YAML of measurement settings that differ")
    parser.add_argument("--terms", action="store_true", help="terms of the standard uncertainties")
    parser.add_argument("--figure", type=Path, help="SVG of the terms to draw")
    parser.add_argument("--bound", action="store_true", help="the random sea beside the Cramer-Rao bound")
    options = parser.parse_args(words)
    if options.terms:
        show_terms(options)
    elif options.bound:
        show_bound(options.seeds or [5601], options.save)
    else:
        compare(options)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
