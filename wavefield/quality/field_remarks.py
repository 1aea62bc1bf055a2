"""Remarks on what was measured: the common view, holes, and how well the cameras agree on the motion."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from wavefield.store.verdict import Remark

MIN_COVERAGE = 0.5  # of the grid in common view: less is remarked upon
MIN_USEFUL_COVERAGE = 0.05  # less is refused before a run, and makes a cube useless
MIN_MEASURED = 0.7  # of the nodes in view: fewer are remarked upon
MIN_USEFUL_MEASURED = 0.2  # fewer are worth nothing
MAX_EPS_PIV = 0.15  # px: a larger median eps' is remarked upon
MAX_USEFUL_EPS_PIV = 0.5  # px: a larger one makes values useless


def remark_on_coverage(seen: float) -> Iterator[Remark]:
    """Report a grid of which the cameras see little in common; ``seen`` is the share of its nodes."""
    if seen < MIN_COVERAGE:
        yield Remark(
            "grid",
            "coverage",
            "grave" if seen < MIN_USEFUL_COVERAGE else "remark",
            f"the cameras have {100 * seen:.2g} % of the grid's nodes in common view",
            f"{100 * MIN_COVERAGE:.0f} % at least",
            "check the extent of the grid, which is in metres, or leave it out: `grid: auto`",
            {"fraction": seen},
        )


def remark_on_holes(measured: float) -> Iterator[Remark]:
    """Report that few of the nodes in view were measured."""
    if measured < MIN_MEASURED:
        yield Remark(
            "surface",
            "holes",
            "grave" if measured < MIN_USEFUL_MEASURED else "remark",
            f"{100 * measured:.0f} % of the nodes in view were measured; the others are filled or empty",
            f"{100 * MIN_MEASURED:.0f} % at least",
            "check seeding and light; `quality` gives the reason why nodes were rejected",
            {"fraction": measured},
        )


def remark_on_eps_piv(z: NDArray[np.floating], eps_piv: NDArray[np.floating]) -> Iterator[Remark]:
    """Report that the cameras are inconsistent on the motion of the water; eps' in px where z is finite."""
    valid = np.isfinite(z) & np.isfinite(eps_piv)
    misfit = float(np.median(np.abs(eps_piv[valid]))) if valid.any() else 0.0
    if misfit > MAX_EPS_PIV:
        yield Remark(
            "velocity",
            "eps'",
            "grave" if misfit > MAX_USEFUL_EPS_PIV else "remark",
            f"the cameras are inconsistent on the motion of the water: median eps' {misfit:.2f} px",
            f"less than {MAX_EPS_PIV} px",
            "are the frames of the same moments, and of the same order, for all cameras?",
            {"eps_piv": misfit},
        )
