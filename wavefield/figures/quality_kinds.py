"""What the quality of a node is in one word, with its colour."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.variables import Quality

# one kind for each node, the first that applies: bit of `quality`, in words, colour (of Okabe and Ito's)
KINDS: tuple[tuple[str, str, str], ...] = (
    ("OUTSIDE", "outside the view", "#d9d9d9"),
    ("MASKED", "masked", "#000000"),
    ("REJECTED_RANGE", "rejected: beyond the range", "#009E73"),
    ("REJECTED_CORRELATION", "rejected: correlation", "#D55E00"),
    ("REJECTED_EPS", "rejected: mismatch", "#E69F00"),
    ("REJECTED_NEIGHBOURS", "rejected: neighbours", "#CC79A7"),
    ("FILLED", "filled", "#56B4E9"),
    ("FEWER_CAMERAS", "measured without a camera", "#F0E442"),
    ("MEASURED", "measured", "#0072B2"),
)


def quality_kind(quality: NDArray[Any]) -> NDArray[np.uint8]:
    """Index into `KINDS` of each node, by the gravest of its bits; their number where none is set."""
    out = np.full(np.shape(quality), len(KINDS), np.uint8)
    for index in range(len(KINDS) - 1, -1, -1):
        out[(np.asarray(quality) & np.uint16(Quality[KINDS[index][0]])) != 0] = index
    return out


def drawn_kind(quality: NDArray[Any]) -> NDArray[np.float32]:
    """The same for pictures: NaN where nothing applies."""
    kinds = quality_kind(quality)
    return np.where(kinds < len(KINDS), kinds, np.nan).astype(np.float32)
