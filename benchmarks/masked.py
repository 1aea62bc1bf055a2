"""A cylinder that stands in the sea and is masked: what changes at the nodes beside it.

    python -m benchmarks.masked [--seeds 311 312 313] [--across 0.2]

The same sea is drawn twice, with the cylinder and without; both are measured, in units of the stated standard
uncertainty of what is measured without it. Farther than a window from what any camera has masked nothing
should change; nearer, windows are cut. What is learned of a record differs a little, too, where a part of it
is masked: a third measurement, masked and with the record of the whole sea, tells how much that does.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.cubes import say
from benchmarks.scenes import HALF
from wavefield.measurement import GridGeometry, Model, learn, measure, sample_steps
from wavefield.measurement.learn import SAMPLES
from wavefield.measurement.learned_record import LearnedRecord
from wavefield.measurement.masked import covered_in
from wavefield.series import FrameSeries
from wavefield.series.masks import MaskSection, covered_series, footprints
from wavefield.tank import Scene, Tank
from wavefield.variables import Quality

FIELDS = ("z", "u", "v", "w")
FRAMES = 6  # of one step
LAST = 80  # of the record, whose samples are learned from as by a run
MASKED = int(Quality.MASKED)

Images = dict[str, list[NDArray[Any]]]


def covered(tank: Tank, shape: MaskSection, reach: float) -> dict[str, NDArray[np.bool_]]:
    """Pixels of every camera that a shape covers, the water reaching so far up and down."""
    blank = {name: FrameSeries(name, 0, [], tank.rig[name].size[::-1], "uint8") for name in tank.rig}
    series = covered_series({"water": [shape]}, blank, tank.rig, Path(), reach)
    return {name: one.mask.covered(0) for name, one in series.items() if one.mask is not None}


def with_cylinder(images: Images, where: Mapping[str, NDArray[np.bool_]], seed: int) -> Images:
    """The frames with the cylinder in them: grey and speckled, not moving."""
    rng = np.random.default_rng(seed)
    out = {}
    for name, frames in images.items():
        paint = np.clip(rng.normal(np.percentile(frames[0], 90), 12.0, frames[0].shape), 0, 255)
        out[name] = [np.where(where[name], paint, frame).astype(frame.dtype) for frame in frames]
    return out


def learned(images: Images, geometry: GridGeometry, masks: Mapping[str, Any] | None) -> LearnedRecord:
    """What a run would learn of the record."""
    instants = [{name: frames[k] for name, frames in images.items()} for k in range(2 * SAMPLES)]
    pairs = list(zip(instants[::2], instants[1::2], strict=True))
    record = learn(pairs, geometry, [(masks, masks)] * len(pairs) if masks else None)
    assert record is not None
    return record


def one_step(
    images: Images,
    geometry: GridGeometry,
    record: LearnedRecord,
    masks: Mapping[str, Any] | None,
    rate: float,
) -> dict[str, Any]:
    """A step measured as a run does."""
    every = {name: [pixels] * FRAMES for name, pixels in masks.items()} if masks else None
    return measure(images, geometry, rate, Model(geometry, record), every)


def hidden_from_any(z: NDArray[Any], masks: Mapping[str, Any], geometry: GridGeometry) -> NDArray[np.bool_]:
    """Nodes that one camera at least does not see for its mask."""
    covered = covered_in(masks, geometry)
    seen = [one.at(*geometry.sights[name].position(z)) for name, one in covered.items()]
    return np.asarray(np.logical_or.reduce(seen))


def change(seed: int, across: float) -> dict[str, Any]:
    """Changes at every node in standard uncertainties, and how far it is from what is masked."""
    tank = Tank(Scene.load("full").with_(seed=seed, frames=LAST, **HALF))
    drawn = [tank.render(k) for k in range(FRAMES)]
    images = {name: [one[name] for one in drawn] for name in tank.rig}
    known = [tank.render(k) for first in sample_steps(LAST - 1) for k in (first, first + 1)]
    record = {name: [one[name] for one in known] for name in tank.rig}
    grid, rate = tank.scene.grid, tank.scene.frame_rate
    size = {"x": 0.0, "y": 0.0, "radius": across / 2}
    standing = MaskSection(cylinder=size | {"top": 0.05, "bottom": -0.02})  # type: ignore[arg-type]
    masked = MaskSection(cylinder=size | {"top": 0.05})  # type: ignore[arg-type]
    free_plan = GridGeometry(tank.rig, grid)
    geometry = GridGeometry(tank.rig, grid, covered=footprints({"water": [masked]}))
    masks = covered(tank, masked, -geometry.z_range[0])
    hides = covered(tank, standing, 0.02)
    painted, painted_record = with_cylinder(images, hides, seed), with_cylinder(record, hides, seed)
    whole = learned(record, free_plan, None)
    free = one_step(images, free_plan, whole, None, rate)
    beside = one_step(painted, geometry, learned(painted_record, geometry, masks), masks, rate)
    given = one_step(painted, geometry, whole, masks, rate)
    unmasked = one_step(painted, free_plan, learned(painted_record, free_plan, None), None, rate)
    hidden = (beside["quality"][0] & MASKED) != 0
    hidden |= hidden_from_any(np.nan_to_num(free["z"][0]).astype(np.float32), masks, geometry)
    distance = cv2.distanceTransform((~hidden).astype(np.uint8), cv2.DIST_L2, 5) * grid.step
    window = max(geometry.settings.piv.window, geometry.settings.stereo.window) * geometry.pixel

    def apart(found: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
        return {n: np.abs(found[n][0] - free[n][0]) / free[f"{n}_std"][0] for n in FIELDS}

    return {
        "window": window,
        "far": distance > window,
        "farther": distance > 3 * window,
        "near": (distance > 0) & (distance <= window),
        "hidden": hidden,
        "masked": apart(beside),
        "given": apart(given),
        "unmasked": apart(unmasked),
    }


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.nanmean(np.square(values)))) if np.isfinite(values).any() else float("nan")


def main(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[311, 312, 313])
    parser.add_argument("--across", type=float, default=0.2, help="diameter of the cylinder, m")
    options = parser.parse_args(words)
    found = [change(seed, options.across) for seed in options.seeds]

    def gathered(which: str, where: str, name: str) -> NDArray[Any]:
        return np.concatenate([one[which][name][one[where]] for one in found])

    first = found[0]
    print(
        f"cylinder {options.across:g} m across; windows {1e3 * first['window']:.0f} mm; nodes hidden "
        f"{[int(one['hidden'].sum()) for one in found]}, nearer than a window "
        f"{[int(one['near'].sum()) for one in found]}, farther {[int(one['far'].sum()) for one in found]}"
    )
    for where, words_of, asked in (
        ("far", "more than a window away", "< .1 std"),
        ("farther", "more than three windows away", "< .1 std"),
        ("near", "nearer than a window", ""),
    ):
        for name in FIELDS:
            values = gathered("masked", where, name)
            lost = 100 * np.mean(~np.isfinite(values))
            reached = (
                f"rms {_rms(values):.3f}, below .1 {100 * np.nanmean(values < 0.1):.1f} %, most "
                f"{np.nanmax(values):.2f}, lost {lost:.1f} %; with the record of the whole sea rms "
                f"{_rms(gathered('given', where, name)):.3f}; without a mask rms "
                f"{_rms(gathered('unmasked', where, name)):.2f}"
            )
            say(f"change of {name} {words_of}", asked, reached)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
