"""What subtracting a background gains where something fixed shows between the beads.

    python -m benchmarks.background [--seeds N ...] [--frames N] [--save]

The random sea of `benchmarks.measurement`, the middle half of every sensor, exact cameras. Every camera sees
a pattern of its own that does not move, such as a scratched floor or reflections: a spot of a bead's size on
each 40 pixels, up to so many grey levels bright (a bead: 110). The background is the mean of ``--frames``
frames, every 7th of the record, as `wavefield background` computes it.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

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
    "within one standard uncertainty: z, u, v, w",
)
Grey = NDArray[np.uint8]


def pattern(shape: tuple[int, ...], height: float, seed: int) -> NDArray[np.float64]:
    """Spots at places of their own in an image, grey levels (row, column)."""
    draws = np.random.default_rng([seed, 90])
    spots = np.where(draws.random(shape) < 1 / PIXELS_PER_SPOT, draws.random(shape), 0.0)
    return height * 2 * np.pi * WIDTH**2 * np.asarray(cv2.GaussianBlur(spots, (0, 0), WIDTH))


def drawn(tank: Tank, numbers: Sequence[int], height: float) -> dict[str, list[Grey]]:
    """Frames with the pattern of each camera in them."""
    out: dict[str, list[Grey]] = {name: [] for name in tank.rig}
    fixed: dict[str, NDArray[np.float64]] = {}
    for number in numbers:
        for k, (name, image) in enumerate(tank.render(number).items()):
            if name not in fixed:
                fixed[name] = np.rint(pattern(image.shape, height, 10 * tank.scene.seed + k))
            out[name].append(np.clip(image + fixed[name], 0, 255).astype(np.uint8))
    return out


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[71, 72, 73])
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--save", action="store_true", help="write benchmarks/results/background.yaml")
    options = parser.parse_args(words)
    rows = []
    for height in PATTERNS:
        scores = {"as it is": Score(), "subtracted": Score()}
        for seed in options.seeds:
            tank = Tank(scene("random", seed))
            case = Case(
                tank.rig,
                tank.scene.grid,
                tank.scene.frame_rate,
                drawn(tank, range(FRAMES), height),
                truths(tank),
            )
            record = drawn(tank, range(0, EVERY * options.frames, EVERY), height)
            means = {
                name: np.rint(np.mean(images, axis=0)).astype(np.uint8) for name, images in record.items()
            }
            less = {
                name: [subtracted(image, means[name]) for image in images]
                for name, images in case.frames.items()
            }
            for name, one in (("as it is", case), ("subtracted", replace(case, frames=less))):
                scores[name].add(one, reconstruct(one, Settings()))
        for name, score in scores.items():
            rows.append([str(height), name, *score.cells()])
            score.report(f"pattern of {height} grey levels, {name}")
    if options.save:
        save_result("background", COLUMNS, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
