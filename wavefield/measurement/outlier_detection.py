"""Cameras and pairs that contradict each other: who is left out, and which nodes are not to be trusted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wavefield.measurement.pair_surface import PairMatch

Float = NDArray[Any]
Mask = NDArray[np.bool_]

MISFIT = 12.0  # chi^2 per degree of freedom, median over the nodes: more, and a camera lies
NODE = 36.0  # the same of a single node
APART = 1.5  # px: two pairs' parallax for one surface
_AROUND = (5, 5)  # blocks
_WIDE = (9, 9)  # blocks: over so many the pairs' own noise is below a third of what follows
_ASK = 0.75  # px: what pairs ask of one surface, in parallax
_TELLING = 0.3  # of the mean Hessian: less says nothing
_FELT = np.ones((5, 5), np.uint8)  # blocks: what windows pull along
_FEW = 50  # nodes: less tell nothing
_MOST = 0.5  # of the nodes around must contradict


def outlier_camera(count: int, typical: float, without: Callable[[int], float]) -> int | None:
    """The camera without which the others agree.

    Three cameras have but one displacement over along the line on which they stand: whichever is left out,
    the other two agree, and who trembles that way cannot be told.

    Examples
    --------
    >>> outlier_camera(3, 500.0, lambda n: 1.0 if n == 1 else 400.0)
    1
    >>> outlier_camera(3, 500.0, lambda n: 400.0 if n == 1 else 1.0) is None
    True
    """
    if count < 3 or not typical > MISFIT:
        return None
    rest = [without(n) for n in range(count)]
    explain = [n for n, left in enumerate(rest) if left < min(MISFIT, 0.1 * typical)]
    return explain[0] if len(explain) == 1 else None


def median_misfit(misfit: Float, known: Mask) -> float:
    """Median misfit over the nodes that all cameras measured.

    With misfit (ny, nx); known (ny, nx).
    """
    good = known & np.isfinite(misfit)
    return float(np.median(misfit[good])) if good.sum() >= _FEW else 0.0


def regions(
    misfit: Float, known: Mask, count: int, without: Callable[[int], Float], reach: int
) -> dict[int, Mask]:
    """Where one camera contradicts the others, which agree without it.

    With misfit (ny, nx); known (ny, nx); returns (ny, nx): Nodes by the number of the camera to be left out
    there.
    """
    side = (2 * reach + 1, 2 * reach + 1)
    bad = (known & (misfit > MISFIT)).astype(np.float32)
    if count < 3 or bad.sum() < _FEW:
        return {}
    most = cv2.blur(bad, side) > np.float32(_MOST) * cv2.blur(known.astype(np.float32), side)
    number, labels = cv2.connectedComponents((most & known).view(np.uint8))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, side)
    others: dict[int, Float] = {}
    out: dict[int, Mask] = {}
    for label in range(1, number):
        here = labels == label

        def misfit_without(n: int, here: Mask = here) -> float:
            if n not in others:
                others[n] = without(n)
            return median_misfit(others[n], here)

        outlier = outlier_camera(count, median_misfit(misfit, here), misfit_without)
        if outlier is not None:
            wide = cv2.dilate(here.view(np.uint8), disc) > 0
            out[outlier] = out.get(outlier, np.zeros_like(known)) | wide
    return out


def pairs_apart(matches: Sequence[PairMatch], pixel: float) -> Mask:
    """Blocks at which pairs of cameras see different surfaces.

    With pixel, metres; returns (ny, nx): Where their elevations differ by more than 1.5 px of parallax, on
    the mean of 5 x 5 blocks, and two blocks around.
    """
    out = np.zeros(matches[0].eps_y.shape, bool)
    for one, other in pairwise(matches):
        z, length = zip(*(_along(m) for m in (one, other)), strict=True)
        both = (one.valid & other.valid).astype(np.float32)
        apart = (z[0] - z[1]) * np.minimum(*length) / np.float32(pixel)
        mean = cv2.blur(np.where(both > 0, apart, np.float32(0)), _AROUND)
        out |= np.abs(mean) > np.float32(APART) * np.maximum(cv2.blur(both, _AROUND), np.float32(0.2))
    return widened(out)


def scores_apart(scores: Sequence[Float], hessians: Sequence[Float], lengths: Sequence[Float]) -> Mask:
    """Blocks around which pairs of cameras, asked about one surface, want it moved to different heights.

    Whole matches may differ by much more and yet a bead's width hides it; at the surface that both have been
    brought to nothing but noise should be left: .02 to .07 px (standard deviation) on bright and on dark
    images, .36 px at most.

    With scores, hessians (ny, nx); lengths (ny, nx), px per metre; returns (ny, nx): Where sum s / sum H over
    9 x 9 blocks differs by more than .75 px of parallax, and two blocks around.
    """
    wide = [(cv2.blur(s, _WIDE), cv2.blur(h, _WIDE)) for s, h in zip(scores, hessians, strict=True)]
    out = np.zeros(scores[0].shape, bool)
    for ((s, h), a), ((t, g), b) in pairwise(zip(wide, lengths, strict=True)):
        usable = (h > np.float32(_TELLING) * h.mean()) & (g > np.float32(_TELLING) * g.mean())
        tiny = np.float32(1e-30)
        apart = (s / np.maximum(h, tiny) - t / np.maximum(g, tiny)) * np.minimum(a, b)
        out |= usable & (np.abs(apart) > np.float32(_ASK))
    return widened(out)


def widened(where: Mask) -> Mask:
    """Blocks and those that feel what is there, two to every side."""
    return np.asarray(cv2.dilate(where.view(np.uint8), _FELT) > 0)


def _along(match: PairMatch) -> tuple[Float, Float]:
    """Elevation by one pair, metres, and the length of its parallax."""
    square = np.sum(np.square(match.parallax), axis=0)
    return -np.sum(match.parallax * match.difference, axis=0) / square, np.sqrt(square)
