"""How well cameras agree, pair by pair and instant by instant, and what each shows by itself."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.quality.patch_matching import (
    STILL,
    Pair,
    PairConsistency,
    PatchMatcher,
    agreement,
    compare,
    grounds,
    most_alike,
    rms_over_field,
)
from wavefield.quality.quality_limits import CAMERA_LIMITS

MAX_SCATTER = 0.4  # px of eps_y: more is not the same water


class ConsistencyTable:
    """Agreements of all pairs at all instants."""

    def __init__(
        self, patch_matcher: PatchMatcher, names: list[str], frames: tuple[int, ...], threads: int = 1
    ) -> None:
        self.patch_matcher, self.names, self.frames = patch_matcher, names, frames
        self.pairs: list[Pair] = list(combinations(names, 2))
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(lambda name: patch_matcher.patches(name, frames[0]), names))  # lays out its lens
            self.grounds = dict(zip(frames, pool.map(lambda k: grounds(patch_matcher, k, names), frames)))
            found = list(pool.map(lambda k: [self.compare(pair, k) for pair in self.pairs], frames))
            blurs = list(pool.map(lambda k: [blur(patch_matcher.read(name, k)) for name in names], frames))
        self.found: dict[Pair, list[PairConsistency]] = dict(zip(self.pairs, map(list, zip(*found))))
        self.blur: dict[str, list[float]] = dict(zip(names, map(list, zip(*blurs))))

    def compare(
        self, pair: Pair, frame: int, images: Pair | None = None, *, change: str = "", later: int = 0
    ) -> PairConsistency:
        """Images of the cameras of a pair, or of two others through the lenses of the pair.
        Those of the second may be changed, or of another moment.
        """
        patch_matcher, (a, b), (first, second) = self.patch_matcher, pair, images or pair
        found = []
        for plane in patch_matcher.planes:
            laid = partial(patch_matcher.sampled, plane=plane) if plane != STILL else patch_matcher.patches
            one, other = laid(first, frame, "", a), laid(second, frame + later, change, b)
            found.append(patch_matcher.on_still_water(compare(one, other), pair, plane))
        ground = self.grounds[frame][first] if first == a else None
        if not change and second == b and ground is not None:
            ground = ground & self.grounds[frame][second]
        return agreement(patch_matcher, pair, most_alike(found), ground)

    def level(self) -> float:
        """Fraction of patches from which on two cameras agree."""
        return max(
            CAMERA_LIMITS.agreement,
            CAMERA_LIMITS.agreement_to_best * max(score(found) for found in self.found.values()),
        )

    def good(self) -> list[Pair]:
        """Pairs of cameras that agree."""
        limit = self.level()
        return [pair for pair, found in self.found.items() if score(found) >= limit]

    def camera_numbers(self) -> dict[str, dict[str, list[float]]]:
        """Of every camera, over time."""
        return {
            name: {
                "blur": [round(value, 3) for value in self.blur[name]],
                "brightness": [round(self._brightness(name, k), 2) for k in self.frames],
                "coverage": [round(1 - value, 3) for value in covered(self, name)],
            }
            for name in self.names
        }

    def pair_numbers(self) -> dict[str, dict[str, list[float]]]:
        """Of every pair, over time."""
        return {
            "-".join(pair): {
                "agreement": [round(one.fraction, 3) for one in found],
                "eps_y": [round(rms_over_field(one.smooth), 3) for one in found],
            }
            for pair, found in self.found.items()
        }

    def _brightness(self, name: str, frame: int) -> float:
        return float(np.asarray(self.patch_matcher.read(name, frame)).mean())


def score(found: Sequence[PairConsistency]) -> float:
    """How well two cameras agree over some instants: patches found, nothing if they scatter."""
    scatter = [one.eps_y.std() for one in found if len(one.eps_y) >= 4]
    if not scatter or float(np.median(scatter)) >= MAX_SCATTER:
        return 0.0
    return float(np.mean([one.fraction for one in found]))


def blur(image: NDArray[np.generic] | None) -> float:
    """Standard deviation of the finest details of an image, px, from the correlation of neighbouring pixels.
    Unlike `bead_width`, also of images without beads and of any width.
    """
    if image is None:
        return float("nan")
    fine = np.asarray(image, np.float32)
    fine = fine - cv2.blur(fine, (15, 15))
    power = float((fine * fine).mean())
    if power <= 0:
        return float("nan")
    one, two = (
        [float((fine[k:] * fine[:-k]).mean()), float((fine[:, k:] * fine[:, :-k]).mean())] for k in (1, 2)
    )
    # two pixels apart over one: white noise has no part in either
    ratio = np.clip(np.array(two) / np.maximum(one, 1e-6 * power), 1e-4, 0.9999)
    return float(np.sqrt(-3 / (4 * np.log(np.sqrt(ratio.prod())))))


def covered(table: ConsistencyTable, name: str) -> list[float]:
    """Fraction of the patches in which a camera shows nothing where another shows something."""
    out = []
    for ground in table.grounds.values():
        others = np.mean([ground[other] for other in table.names if other != name], axis=0) > 0.5
        out.append(float((others & ~ground[name]).sum() / max(others.sum(), 1)))
    return out
