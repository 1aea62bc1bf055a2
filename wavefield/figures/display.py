"""How variables are displayed: units, colours and limits of colour scales; the quality of a node in words."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wavefield.variables import TABLE, Quality

SIGNED, POSITIVE = "RdBu_r", "cividis"  # colour maps that keep their order for colour-blind readers
BALANCE = ("z", "z_t", "u", "v", "w")  # the variables of the kinematic condition
DERIVED = ("vorticity", "divergence", "residual")  # computed from those
MARKS_ACROSS = 24  # arrows or dots along the longer side of a grid, so that each can be told apart

# by stored unit: factor to the displayed unit, and that unit
_UNITS = {
    "m": (100.0, "cm"),
    "m s-1": (100.0, "cm/s"),
    "s-1": (1.0, "1/s"),
    "pixel": (1.0, "px"),
    "1": (1.0, ""),
}


def thin(*sizes: int) -> slice:
    """Return the slice that, applied to every axis of a grid, leaves about 24 nodes along the longest axis.
    `sizes` are the numbers of nodes along the axes."""
    every = max(1, round(max(sizes) / MARKS_ACROSS))
    return slice(every // 2, None, every)


def limit(values: ArrayLike, percent: float = 99.5) -> float:
    """Return the upper end of a colour scale symmetric about zero: the percentile `percent` of |values|.
    The result is 1 if no value is finite."""
    finite = np.abs(np.asarray(values, float))
    finite = finite[np.isfinite(finite)]
    return float(np.percentile(finite, percent)) or 1e-9 if finite.size else 1.0


@dataclass(frozen=True)
class Display:
    """How one variable is displayed: its name, unit, factor to this unit, and colours."""

    name: str
    factor: float  # stored values times this are in the displayed unit
    unit: str  # the displayed unit; empty for pure numbers

    @property
    def in_unit(self) -> str:
        """The unit in brackets after a space, such as " (cm)"; empty for pure numbers."""
        return f" ({self.unit})" if self.unit else ""

    @property
    def label(self) -> str:
        """Name and unit, as on an axis, such as "z (cm)"."""
        return self.name + self.in_unit

    @property
    def long_name(self) -> str:
        """Description of the variable from the table of variables."""
        return TABLE[self.name].long_name

    @property
    def signed(self) -> bool:
        """Whether the variable can be negative; its colours are then symmetric about zero."""
        return not self.name.endswith("_std") and self.name not in ("eps_piv", "quality")

    @property
    def colour_map(self) -> str:
        """The name of the matplotlib colour map, which suits colour-blind readers."""
        return SIGNED if self.signed else POSITIVE

    def limits(self, values: NDArray[np.floating]) -> tuple[float, float]:
        """Return the lower and upper end of the colour scale for values in the displayed unit.
        The upper end is the 99.5 % quantile of |values|. For a signed variable the lower end is the negative
        of the upper end. For others it is zero, or the 0.5 % quantile of the values if that exceeds half of
        the upper end."""
        half = float(f"{limit(values):.2g}")
        if self.signed:
            return -half, half
        finite = np.asarray(values, float)[np.isfinite(values)]
        low = float(f"{np.percentile(finite, 0.5):.2g}") if finite.size else 0.0
        return (low if half / 2 < low < half else 0.0), half


def display(name: str) -> Display:
    """Return how the variable `name` is displayed: z in cm, other lengths in mm, velocities in cm/s."""
    units = TABLE[name].units
    if units == "m" and name != "z":
        return Display(name, 1000.0, "mm")
    return Display(name, *_UNITS[units])


# The kind of a node is the first that applies: bit of `quality`, words, colour (of Okabe and Ito 2008)
KINDS: tuple[tuple[str, str, str], ...] = (
    ("OUTSIDE", "outside the view", "#d9d9d9"),
    ("MASKED", "masked", "#000000"),
    ("REJECTED_RANGE", "rejected: beyond the range", "#009E73"),
    ("REJECTED_CORRELATION", "rejected: correlation", "#D55E00"),
    ("REJECTED_EPS", "rejected: epipolar error", "#E69F00"),
    ("REJECTED_NEIGHBOURS", "rejected: neighbours", "#CC79A7"),
    ("FILLED", "filled", "#56B4E9"),
    ("FEWER_CAMERAS", "measured without a camera", "#F0E442"),
    ("MEASURED", "measured", "#0072B2"),
)


def quality_kind(quality: NDArray[Any]) -> NDArray[np.uint8]:
    """Return, for each value of `quality`, the index of the first kind in `KINDS` whose bit is set.
    The result has the shape of `quality`, and is `len(KINDS)` where no kind applies."""
    out = np.full(np.shape(quality), len(KINDS), np.uint8)
    for index in range(len(KINDS) - 1, -1, -1):
        out[(np.asarray(quality) & np.uint16(Quality[KINDS[index][0]])) != 0] = index
    return out


def drawn_kind(quality: NDArray[Any]) -> NDArray[np.float32]:
    """Return the result of `quality_kind` as floats, for a picture; NaN where no kind applies."""
    kinds = quality_kind(quality)
    return np.where(kinds < len(KINDS), kinds, np.nan).astype(np.float32)
