"""Which lens model the data support: Bayes' information criterion over nested models."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.errors import CalibrationError

# "paper" is that of the paper; "tilt" is equivalent to moving the principal point, and better conditioned.
# The two together (c and tilt) have a condition number of 1e8 and more: on request only.
MODELS: dict[str, tuple[str, ...]] = {
    "f": ("f",),
    "f k1": ("f", "k1"),
    "f c": ("f", "c"),
    "f c k1": ("f", "c", "k1"),
    "paper": ("f", "aspect", "c", "k1"),
    "f tilt k1": ("f", "tilt", "k1"),
    "tilt": ("f", "aspect", "tilt", "k1"),
    "paper k2": ("f", "aspect", "c", "k1", "k2"),
    "paper p": ("f", "aspect", "c", "k1", "p"),
    "paper k2 p": ("f", "aspect", "c", "k1", "k2", "p"),
    "opencv": ("f", "aspect", "c", "k1", "k2", "p", "k3"),
    "c and tilt": ("f", "aspect", "c", "tilt", "k1"),
}
CANDIDATES = (
    *("f", "f k1", "f c", "f c k1", "f tilt k1", "paper", "tilt"),
    *("paper k2", "paper p", "paper k2 p", "opencv"),
)


@dataclass(frozen=True)
class Choice:
    """One row of the comparison.

    Parameters
    ----------
    model : str
        Name in `MODELS`.
    parameters : int
        Free parameters of the joint fit.
    rms : float
        Scatter of the residuals in units of the stated uncertainty.
    bic : float
        Bayes' information criterion; the smallest is chosen.
    """

    model: str
    parameters: int
    rms: float
    bic: float


def terms_of(model: str | Sequence[str]) -> tuple[str, ...]:
    """Free terms of a model given by name or as a list of terms.

    Parameters
    ----------
    model : str or sequence of str
        Name in `MODELS`, or terms of `wavefield.calibration.bundle.TERMS`.

    Returns
    -------
    tuple of str

    Raises
    ------
    CalibrationError
        If it is neither.
    """
    from wavefield.calibration.bundle import TERMS

    if isinstance(model, str):
        if model not in MODELS:
            raise CalibrationError(f"camera model {model!r} is not known; use auto, {', '.join(MODELS)}")
        return MODELS[model]
    unknown = [term for term in model if term not in TERMS]
    if unknown or "f" not in model:
        raise CalibrationError(f"camera model {list(model)} is not made of f, {', '.join(list(TERMS)[1:])}")
    return tuple(model)


def choose(
    fit_model: Callable[[tuple[str, ...]], Fit], count: int
) -> tuple[str, dict[str, Fit], list[Choice]]:
    """Fit every candidate and choose.

    Parameters
    ----------
    fit_model : callable
        From terms to a `Fit`, all with the same bend of the loss.
    count : int
        Number of residuals.

    Returns
    -------
    best : str
        Name in `MODELS`.
    fits : dict of str to Fit
        By name.
    table : list of Choice
        In the order tried.

    Notes
    -----
    BIC = n ln(chi2 / n) + k ln n with the robust sum of squares, as the scale of the noise is not known.
    """
    fits, table = {}, []
    for name in CANDIDATES:
        fits[name] = found = fit_model(MODELS[name])
        k = len(found.layout.names)
        bic = count * np.log(max(found.chi2, 1e-300) / count) + k * np.log(count)
        table.append(Choice(name, k, float(np.sqrt(found.chi2 / count)), float(bic)))
    best = min(table, key=lambda row: row.bic).model
    return best, fits, table
