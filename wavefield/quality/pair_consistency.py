"""How well cameras agree, pair by pair and instant by instant, and what each shows by itself."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.quality.patch_matching import (
    Pair,
    PairConsistency,
    PatchMatcher,
    agreement,
    compare,
    grounds,
    pairs_of_all,
    pooled,
)

LEAST = 0.2  # of the patches: two cameras that agree in fewer do not agree
_BESIDE = 0.5  # of what the best pair of cameras agrees in
_SCATTER = 0.4  # px of eps_y: more is not the same water


class ConsistencyTable:
    """Agreements of all pairs at all instants."""

    def __init__(
        self, patch_matcher: PatchMatcher, names: list[str], frames: tuple[int, ...], threads: int = 1
    ) -> None:
        self.patch_matcher, self.names, self.frames = patch_matcher, names, frames
        self.pairs = pairs_of_all(names)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(lambda name: patch_matcher.patches(name, frames[0]), names))  # lays out its lens
            self.grounds = dict(zip(frames, pool.map(lambda k: grounds(patch_matcher, k, names), frames)))
            pair_consistencies = list(pool.map(self._pair_consistencies, frames))
            blurs = list(pool.map(lambda k: [blur(patch_matcher.read(name, k)) for name in names], frames))
        self.found: dict[Pair, list[PairConsistency]] = dict(
            zip(self.pairs, map(list, zip(*pair_consistencies)))
        )
        self.blur: dict[str, list[float]] = dict(zip(names, map(list, zip(*blurs))))

    def _pair_consistencies(self, frame: int) -> list[PairConsistency]:
        return [self.compare(pair, frame, pair[0], pair[1]) for pair in self.pairs]

    def compare(
        self, pair: Pair, frame: int, first: str, second: str, *, change: str = "", later: int = 0
    ) -> PairConsistency:
        """Images of two cameras through the lenses of a pair; the second changed, or of another moment."""
        patch_matcher, a, b = self.patch_matcher, *pair
        one = patch_matcher.patches(first, frame, "", a)
        other = patch_matcher.patches(second, frame + later, change, b)
        ground = self.grounds[frame][first] if first == a else None
        if not change and second == b and ground is not None:
            ground = ground & self.grounds[frame][second]
        return agreement(patch_matcher, pair, compare(one, other), ground)

    def level(self) -> float:
        """Fraction of patches from which on two cameras agree."""
        return max(LEAST, _BESIDE * max(score(found) for found in self.found.values()))

    def good(self) -> list[Pair]:
        """Pairs of cameras that agree."""
        limit = self.level()
        return [pair for pair, found in self.found.items() if score(found) >= limit]

    def camera_numbers(self) -> dict[str, dict[str, list[float]]]:
        """Of every camera, over time."""
        return {
            name: {
                "blur": [round(value, 3) for value in self.blur[name]],
                "brightness": [round(float(np.mean(self._image(name, k))), 2) for k in self.frames],
                "coverage": [round(1 - value, 3) for value in covered(self, name)],
            }
            for name in self.names
        }

    def pair_numbers(self) -> dict[str, dict[str, list[float]]]:
        """Of every pair, over time."""
        return {
            "-".join(pair): {
                "agreement": [round(one.fraction, 3) for one in found],
                "eps_y": [round(size(one.smooth), 3) for one in found],
            }
            for pair, found in self.found.items()
        }

    def _image(self, name: str, frame: int) -> NDArray[Any]:
        return np.asarray(self.patch_matcher.read(name, frame))


def score(found: Sequence[PairConsistency]) -> float:
    """How well two cameras agree over some instants: patches found, nothing if they scatter."""
    scatter = [one.eps_y.std() for one in found if len(one.eps_y) >= 4]
    return pooled(found) if scatter and float(np.median(scatter)) < _SCATTER else 0.0


def size(smooth: NDArray[np.float64]) -> float:
    """Rms over the field of the smooth part of eps_y, px."""
    return float(np.sqrt(smooth[0] ** 2 + (smooth[1] ** 2 + smooth[2] ** 2) / 3))


def blur(image: NDArray[Any] | None) -> float:
    """Width of the finest things in an image, px: from how alike neighbouring pixels are.

    With image (rows, columns).
    """
    if image is None:
        return float("nan")
    fine = np.asarray(image, np.float32)
    fine = fine - cv2.blur(fine, (15, 15))
    power = float((fine * fine).mean())
    if power <= 0:
        return float("nan")
    alike = [float((fine[1:] * fine[:-1]).mean()), float((fine[:, 1:] * fine[:, :-1]).mean())]
    across = [float((fine[2:] * fine[:-2]).mean()), float((fine[:, 2:] * fine[:, :-2]).mean())]
    # two pixels aside against one: noise, which is alike in no two pixels, has no part in it
    ratio = np.clip(np.array(across) / np.maximum(alike, 1e-6 * power), 1e-4, 0.9999)
    return float(np.sqrt(-3 / (4 * np.log(np.sqrt(ratio.prod())))))


def covered(table: ConsistencyTable, name: str) -> list[float]:
    """Fraction of the patches in which a camera shows nothing where another shows something."""
    out = []
    for ground in table.grounds.values():
        others = np.mean([ground[other] for other in table.names if other != name], axis=0) > 0.5
        out.append(float((others & ~ground[name]).sum() / max(others.sum(), 1)))
    return out
