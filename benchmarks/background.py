"""What subtracting a background gains where something that does not move shows between the beads.

    python -m benchmarks.background [--seeds N ...] [--frames N] [--save]

The random sea of `benchmarks.measurement`, the middle half of every sensor, exact cameras. Every camera sees
a pattern of its own that does not move, such as a scratched floor: a spot of a bead's size on each 40 pixels,
up to so many grey levels bright (a bead: 110). The background is the mean of ``--frames`` frames, every 7th
of the record, as `wavefield background` computes it. 1 px = 1.8 mm.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.options import parser_of
from benchmarks.results import save_result
from benchmarks.scenes import FRAMES, Case, reconstruct, scene, truths
from benchmarks.scores import Score
from wavefield.measurement import Settings
from wavefield.series.frames import subtracted
from wavefield.tank import Tank

PATTERNS = (0, 30, 90)  # grey levels of the brightest spots
PIXELS_PER_SPOT, WIDTH, EVERY = 40, 0.8, 7  # px2, px, frames
COLUMNS = (
    "fixed pattern, grey levels",
    "background",
    "z",
    "u dt, v dt, w dt",
    "nodes measured",
    "within one standard uncertainty (ideal: 68 %): z, u, v, w",
)
Images = Mapping[str, list[NDArray[Any]]]


def pattern(shape: tuple[int, ...], height: float, seed: int) -> NDArray[Any]:
    """Spots at places of their own in an image, grey levels (row, column)."""
    draws = np.random.default_rng([seed, 90])
    spots = np.where(draws.random(shape) < 1 / PIXELS_PER_SPOT, draws.random(shape), 0.0)
    return height * 2 * np.pi * WIDTH**2 * np.asarray(cv2.GaussianBlur(spots, (0, 0), WIDTH))


def drawn(tank: Tank, numbers: Sequence[int]) -> Images:
    """Frames of every camera."""
    frames = [tank.render(number) for number in numbers]
    return {name: [frame[name] for frame in frames] for name in tank.rig}


def with_pattern(images: Images, height: float, seed: int) -> Images:
    """The same frames over the pattern of each camera."""
    out = {}
    for k, (name, frames) in enumerate(images.items()):
        fixed = np.rint(pattern(frames[0].shape, height, 10 * seed + k))
        out[name] = [np.clip(image + fixed, 0, 255).astype(np.uint8) for image in frames]
    return out


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[71, 72, 73])
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--save", action="store_true", help="write benchmarks/results/background.json")
    options = parser.parse_args(words)
    scores = {(height, how): Score() for height in PATTERNS for how in ("not subtracted", "subtracted")}
    for seed in options.seeds:
        tank = Tank(scene("random", seed))
        frames, truth = drawn(tank, range(FRAMES)), truths(tank)
        record = drawn(tank, range(0, EVERY * options.frames, EVERY))
        for height in PATTERNS:
            images = with_pattern(frames, height, seed)
            case = Case(tank.rig, tank.scene.grid, tank.scene.frame_rate, images, truth)
            means = {
                name: np.rint(np.mean(of_camera, axis=0)).astype(np.uint8)
                for name, of_camera in with_pattern(record, height, seed).items()
            }
            less = {name: [subtracted(image, means[name]) for image in images[name]] for name in images}
            for how, one in (("not subtracted", case), ("subtracted", replace(case, frames=less))):
                scores[height, how].add(one, reconstruct(one, Settings()))
    for (height, how), score in scores.items():
        score.report(f"pattern of {height} grey levels, {how}")
    if options.save:
        rows = [[str(height), how, *score.cells()] for (height, how), score in scores.items()]
        save_result("background", COLUMNS, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
