"""How a variable is displayed: unit, colours, ends of its scale; the quality of a node in words."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wavefield.variables import TABLE, Quality

SIGNED, POSITIVE = "RdBu_r", "cividis"  # colour maps that keep their order for colour-blind readers
BALANCE = ("z", "z_t", "u", "v", "w")  # the variables of the kinematic condition
DERIVED = ("vorticity", "divergence", "residual")  # computed from those

# stored unit: factor to the displayed unit, displayed unit
_UNITS = {
    "m": (100.0, "cm"),
    "m s-1": (100.0, "cm/s"),
    "s-1": (1.0, "1/s"),
    "pixel": (1.0, "px"),
    "1": (1.0, ""),
}


def limit(values: ArrayLike, percent: float = 99.5) -> float:
    """Half-width of a balanced colour scale."""
    finite = np.abs(np.asarray(values, float))
    finite = finite[np.isfinite(finite)]
    return float(np.percentile(finite, percent)) or 1e-9 if finite.size else 1.0


@dataclass(frozen=True)
class Display:
    """Unit, colours and name of one variable for readers."""

    name: str
    factor: float  # from the stored unit to the displayed one
    unit: str  # the displayed unit; empty for pure numbers

    @property
    def in_unit(self) -> str:
        """The unit in brackets, after a space; empty for pure numbers."""
        return f" ({self.unit})" if self.unit else ""

    @property
    def label(self) -> str:
        """Name and unit, as on an axis."""
        return self.name + self.in_unit

    @property
    def long_name(self) -> str:
        """Description of the variable."""
        return TABLE[self.name].long_name

    @property
    def signed(self) -> bool:
        """Whether it has a sign, so that its colours are balanced about zero."""
        return not self.name.endswith("_std") and self.name not in ("eps_piv", "quality")

    @property
    def colour_map(self) -> str:
        """Its matplotlib colour map, whose order colour-blind readers keep."""
        return SIGNED if self.signed else POSITIVE

    def limits(self, values: NDArray[np.floating]) -> tuple[float, float]:
        """Ends of a colour scale for displayed values, without the largest half percent; two digits.
        An unsigned scale begins at zero, or at its smallest values where all are above half of its end.
        """
        half = float(f"{limit(values):.2g}")
        if self.signed:
            return -half, half
        finite = np.asarray(values, float)[np.isfinite(values)]
        low = float(f"{np.percentile(finite, 0.5):.2g}") if finite.size else 0.0
        return (low if half / 2 < low < half else 0.0), half


def display(name: str) -> Display:
    """How a variable of the table is displayed: elevation in cm, its uncertainty and misfits in mm."""
    units = TABLE[name].units
    if units == "m" and name != "z":  # uncertainties and mismatches are small
        return Display(name, 1000.0, "mm")
    return Display(name, *_UNITS[units])


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
