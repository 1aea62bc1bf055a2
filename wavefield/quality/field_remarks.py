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
MAX_UNRESOLVED = 0.3  # of the variance of w by waves that images do not resolve: more is remarked upon
MAX_FAST = 0.3  # of the variance of w by waves that frames do not follow: more is remarked upon
NOTED_FAST = 0.003  # more is noted
UNRESOLVED_STD = 2.0  # standard uncertainties of w with them over those without: more is noted


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


def remark_on_unresolved_waves(
    unresolved: float, wavelength: float, w: float, w_std: float
) -> Iterator[Remark]:
    """Report waves of a wavelength (m) that the images do not resolve, by the standard deviation of their w.
    w is the rms that was measured, w_std its standard uncertainty, which contains them, m/s all.
    """
    share = unresolved**2 / (unresolved**2 + w**2) if unresolved else 0.0
    others = max(w_std**2 - unresolved**2, 0.0)
    if share > MAX_UNRESOLVED or unresolved**2 > (UNRESOLVED_STD**2 - 1.0) * others:
        yield Remark(
            "surface",
            "short waves",
            "remark" if share > MAX_UNRESOLVED else "note",
            f"waves of about {100 * wavelength:.3g} cm and less, which the images do not resolve, have"
            f" {100 * share:.3g} % of the variance of w: w of single nodes is uncertain by"
            f" {1e3 * unresolved:.3g} mm/s for them, which the standard uncertainties contain",
            f"less than {100 * MAX_UNRESOLVED:.0f} %",
            "for these waves take images with smaller pixels; means over nodes and longer waves are sound",
            {"fraction": share, "w_std": unresolved},
        )


def remark_on_fast_waves(share: float, wavelength: float, frame_rate: float) -> Iterator[Remark]:
    """Report waves that turn by more than half a turn from frame to frame: their share of the variance of w,
    the longest of them, m, and frames per second. Shorter ones turn further and may not be detected.
    """
    if share > NOTED_FAST:
        yield Remark(
            "record",
            "fast waves",
            "remark" if share > MAX_FAST else "note",
            f"waves of {100 * wavelength:.3g} cm and less turn by more than half a turn from frame to frame"
            f" at {frame_rate:.3g} Hz and have {100 * share:.3g} % of the detected variance of w: velocities"
            " of these and of shorter waves are not measured, which standard uncertainties may not contain",
            f"at most {100 * MAX_FAST:.0f} %",
            "take images at twice the frame rate or more; longer waves are sound",
            {"fraction": share, "wavelength": wavelength},
        )
