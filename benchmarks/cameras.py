"""Faulty cameras, missing cameras, two, three and four cameras.

    python -m benchmarks.cameras [--only faulty half shaking missing number] [--seeds N ...]

Faulty: mirrored, swapped with another, one frame late, moved by 2 px, out of focus; per cent of all nodes
that are flagged as measured and wrong by more than five of their standard uncertainties (any of z, u, v, w).
Shaking: the same for cameras whose images move from frame to frame, at random, along the line of the cameras.
The random sea, half size (see `benchmarks.scenes`), calibrated cameras; four cameras: exact ones.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from benchmarks.options import run_parts
from benchmarks.scenes import MIDDLE, SEEDS, Case, calibrated, draw, reconstruct, scene
from benchmarks.scores import Score
from wavefield.measurement import Settings
from wavefield.rig import Rig
from wavefield.tank import paper_rig
from wavefield.variables import Quality

FAULTS: dict[str, dict[str, dict[str, Any]]] = {
    "sound": {},
    "cam1 mirrored": {"cam1": {"mirrored": True}},
    "cam1 and cam2 swapped": {"cam1": {"shows": "cam2"}, "cam2": {"shows": "cam1"}},
    "cam1 one frame late": {"cam1": {"late": 1}},
    "cam3 one frame late": {"cam3": {"late": 1}},
    "cam1 moved by 2 px along x": {"cam1": {"shift": (2.0, 0.0)}},
    "cam3 moved by 2 px along x": {"cam3": {"shift": (2.0, 0.0)}},
    "cam1 moved by 2 px along y": {"cam1": {"shift": (0.0, 2.0)}},
    "cam1 out of focus by 3 px": {"cam1": {"defocus": 3.0}},
    "cam3 out of focus by 6 px": {"cam3": {"defocus": 6.0}},
}

WRONG = "measured and wrong by more than 5 std"
HALVES = ("cam1 mirrored", "cam1 one frame late", "cam3 one frame late", "cam1 moved by 2 px along x")

THREE, TWO = ("cam1", "cam2", "cam3"), ("cam1", "cam2")
SHAKING = (
    (THREE, ("cam1",), 0.1),
    (THREE, ("cam1",), 0.3),
    (THREE, ("cam3",), 0.1),
    (THREE, THREE, 0.1),
    (TWO, ("cam1",), 0.1),
)


def reasons(case: Case, cubes: Sequence[dict[str, Any]]) -> str:
    """Share of the nodes with each bit of ``quality``, per cent."""
    quality = np.concatenate([cube["quality"] for cube in cubes])
    count = {bit.name: 100 * float(np.mean((quality & bit) > 0)) for bit in Quality}
    return ", ".join(f"{name} {value:.1f}" for name, value in count.items() if name and value >= 0.05)


def faulty(options: argparse.Namespace) -> None:
    """Every kind of fault in one camera."""
    for kind, faults in FAULTS.items():
        score, cubes = Score(), []
        for seed in options.seeds:
            case = draw(scene("random", seed, faults=faults), calibrated(False))
            cubes.append(reconstruct(case, Settings()))
            score.add(case, cubes[-1])
        score.report(f"{kind}\n    {WRONG}: {score.wrong():.2f} % (asked 0.5)", reasons(case, cubes))


def half_faulty(options: argparse.Namespace) -> None:
    """The same faults in the left half of a camera's image alone."""
    for kind in HALVES:
        score, cubes = Score(), []
        for seed in options.seeds:
            case = draw(scene("random", seed), calibrated(False))
            bad = draw(scene("random", seed, faults=FAULTS[kind]), calibrated(False))
            frames = {
                name: [_left_of(image, other) for image, other in zip(bad.frames[name], images, strict=True)]
                for name, images in case.frames.items()
            }
            cubes.append(reconstruct(replace(case, frames=frames), Settings()))
            score.add(case, cubes[-1])
        score.report(f"left half of {kind}\n    {WRONG}: {score.wrong():.2f} %", reasons(case, cubes))


def _left_of(image: Any, other: Any) -> Any:
    """An image with the left half of another one."""
    out = np.array(other)
    out[:, : out.shape[1] // 2] = image[:, : out.shape[1] // 2]
    return out


def shaking(options: argparse.Namespace) -> None:
    """Cameras that shake along the line of the cameras."""
    for present, shaken, px in SHAKING:
        score = Score()
        for seed in options.seeds:
            case = draw(scene("random", seed), calibrated(False))
            rng = np.random.default_rng(seed)
            frames = {name: case.frames[name] for name in present}
            for name in shaken:
                frames[name] = [_moved(image, rng.normal(0.0, px)) for image in case.frames[name]]
            case = replace(case, frames=frames, rig=Rig({name: case.rig[name] for name in present}))
            score.add(case, reconstruct(case, Settings()))
        head = f"{', '.join(shaken)} of {len(present)} shaking by {px} px rms"
        score.report(f"{head}\n    {WRONG}: {score.wrong():.2f} % (asked 0.5)")


def _moved(image: Any, px: float) -> Any:
    """An image moved along its rows, by Lanczos' interpolation."""
    map_ = np.array([[1.0, 0.0, px], [0.0, 1.0, 0.0]])
    size = image.shape[::-1]
    return cv2.warpAffine(image, map_, size, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)


def missing(options: argparse.Namespace) -> None:
    """A camera without one of the two frames of a step."""
    for lost in ("cam1", "cam2", "cam3"):
        score, marked = Score(), True
        for seed in options.seeds:
            case = draw(scene("random", seed), calibrated(False))
            frames = dict(case.frames)
            frames[lost] = [None if k == MIDDLE else image for k, image in enumerate(frames[lost])]
            cube = reconstruct(replace(case, frames=frames), Settings())
            marked &= bool((cube["quality"][MIDDLE - 2] & Quality.FEWER_CAMERAS).all())
            only = {name: field[MIDDLE - 2 : MIDDLE - 1] for name, field in cube.items()}
            score.add(replace(case, truth=case.truth[MIDDLE - 2 : MIDDLE - 1]), only)
        score.report(f"{lost} missing in one frame; the step is marked: {marked}")


def number(options: argparse.Namespace) -> None:
    """Two, three and four exact cameras."""
    for count in (2, 3, 4):
        score, rig = Score(), paper_rig(crop=0.5, cameras=count)
        for seed in options.seeds:
            case = draw(scene("random", seed, rig={"cameras": count}), rig)
            score.add(case, reconstruct(case, Settings()))
        score.report(f"{count} cameras")


PARTS: dict[str, Callable[[argparse.Namespace], None]] = {
    "faulty": faulty,
    "half": half_faulty,
    "shaking": shaking,
    "missing": missing,
    "number": number,
}


if __name__ == "__main__":
    sys.exit(run_parts(__doc__, PARTS, sys.argv[1:], SEEDS))
