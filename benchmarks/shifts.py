"""Real texture moved by a known shift: whether the range is found by itself, what is measured, and how well.

    python -m benchmarks.shifts FOLDER [--shifts N ...]

FOLDER holds `piv_samples` and `d_specimen`. Both frames are cut from one image, so that what is seen moves by
a whole number of pixels; grey levels of the second bear new noise of 1 %. No settings. Nodes 40 px inside
what both frames show; bare are those with a patch of 17 px within 33 px around them over which the image
scatters by less than 3 % of its range: there is nothing to measure, or the edge of nothing.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.options import parser_of
from wavefield import matching
from wavefield.images import read_image
from wavefield.measurement import Settings
from wavefield.measurement.search_range import first_guess, wide_enough

IMAGES = {
    "Milestone": "piv_samples/Milestone/Images/im00505a.png",
    "Karman": "piv_samples/Karman/Images/Karman_01.bmp",
    "Oseen": "piv_samples/Oseen/Images/Oseen_center_01.tif",
    "Jet": "piv_samples/Jet/Images/c060a.png",
    "wake_legi": "piv_samples/wake_legi/images/B00001A.png",
    "D-specimen": "d_specimen/images/GT4-0000_0.tif",
}
INSIDE, PATCH, AROUND = 40, 17, 33  # px
NOISE, BARE = 0.01, 0.03  # of the range between the image's 1st and 99.5th percentile

Image = NDArray[np.float32]


def pair(image: Image, shift: int) -> tuple[Image, Image]:
    """Two frames in which what is seen moves to the right."""
    low, high = np.percentile(image, [1.0, 99.5])
    noise = np.random.default_rng(shift).normal(0.0, NOISE * (high - low), image.shape)
    second = image + noise.astype(np.float32)
    return np.ascontiguousarray(image[:, shift:]), np.ascontiguousarray(second[:, : image.shape[1] - shift])


def line(name: str, image: Image, shift: int) -> str:
    """A row of the table."""
    first, second = pair(image, shift)
    guess = first_guess(lambda _, frame: (first, second)[frame], ["cam1"], [0])
    match = matching.match(first, second, wide_enough(Settings(), guess).piv)
    x, y = np.meshgrid(match.x, match.y)
    rows, columns = first.shape
    inside = (x > INSIDE) & (x < columns - INSIDE - shift)  # displacements stand where they start
    inside &= (y > INSIDE) & (y < rows - INSIDE)
    mean = cv2.blur(first, (PATCH, PATCH))
    scatter = np.sqrt(np.maximum(cv2.blur(first * first, (PATCH, PATCH)) - mean * mean, 0.0))
    scatter = cv2.erode(scatter, np.ones((AROUND, AROUND), np.uint8))
    low, high = np.percentile(image, [1.0, 99.5])
    bare = scatter[y.astype(int), x.astype(int)] < BARE * (high - low)
    good = match.valid & inside
    error = np.hypot(match.u - shift, match.v)
    rms = [np.sqrt(np.mean(error[chosen] ** 2) / 2) for chosen in (good, good & ~bare)]
    return (
        f"| {name} | {shift} | {100 * good.sum() / inside.sum():.2f} % | "
        f"{100 * (inside & bare).sum() / inside.sum():.1f} % | "
        f"{100 * (good & ~bare).sum() / max((inside & ~bare).sum(), 1):.2f} % | "
        f"{rms[0]:.4f} | {rms[1]:.4f} | {int(np.sum(error[good] > 1))} |"
    )


def main(words: Sequence[str]) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--shifts", nargs="+", type=int, default=[5, 30, 90, 200])
    parser.add_argument("--only", nargs="+", default=list(IMAGES), choices=list(IMAGES))
    options = parser.parse_args(words)
    print("| image | shift, px | measured | bare | of the rest | rms, px | of the rest | over 1 px off |")
    print("|---|---|---|---|---|---|---|---|")
    for name in options.only:
        image = read_image(options.folder / IMAGES[name]).astype(np.float32)
        for shift in options.shifts:
            if 3 * shift < image.shape[1]:
                print(line(name, image, shift), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
