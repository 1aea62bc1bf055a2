"""Which lens model the data support: Bayes' information criterion over nested models."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wavefield.calibration.bundle import TERMS, Fit
from wavefield.calibration.observations import LENS
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
    *("f c k1", "f", "f k1", "f c", "f tilt k1", "paper", "tilt"),
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
    if isinstance(model, str):
        if model not in MODELS:
            raise CalibrationError(f"camera model {model!r} is not known; use auto, {', '.join(MODELS)}")
        return MODELS[model]
    unknown = [term for term in model if term not in TERMS]
    if unknown or "f" not in model:
        raise CalibrationError(f"camera model {list(model)} is not made of f, {', '.join(list(TERMS)[1:])}")
    return tuple(model)


def beyond_doubt(fit: Fit, sizes: Sequence[tuple[int, int]]) -> set[str]:
    """Terms that some camera needs: ten times their uncertainty away from a perfect camera's.

    Parameters
    ----------
    fit : Fit
        Of a model with c and k1.
    sizes : sequence of (width, height)
        Image sizes, px.

    Returns
    -------
    set of str
        Of "c" and "k1".
    """
    std = np.sqrt(np.diag(fit.covariance))
    sure = set()
    for c, columns in enumerate(fit.layout.lens):
        perfect = {"cx": (sizes[c][0] - 1) / 2, "cy": (sizes[c][1] - 1) / 2, "k1": 0.0}
        for k, column in columns:
            if column in perfect:
                away = abs(fit.geometry.lens[c, LENS.index(column)] - perfect[column])
                if away > 10.0 * std[k]:
                    sure.add("k1" if column == "k1" else "c")
    return sure


def choose(
    fit_model: Callable[[tuple[str, ...]], Fit], count: int, sizes: Sequence[tuple[int, int]]
) -> tuple[str, dict[str, Fit], list[Choice]]:
    """Fit the candidates and choose.

    Parameters
    ----------
    fit_model : callable
        From terms to a `Fit`, all with the same bend of the loss.
    count : int
        Number of residuals.
    sizes : sequence of (width, height)
        Image sizes, px.

    Returns
    -------
    best : str
        Name in `MODELS`.
    fits : dict of str to Fit
        By name.
    table : list of Choice
        In the order tried. Models without a term that is beyond doubt are not tried.

    Notes
    -----
    BIC = n ln(chi2 / n) + k ln n with the robust sum of squares, as the scale of the noise is not known.
    """
    fits: dict[str, Fit] = {}
    table: list[Choice] = []
    sure: set[str] = set()
    for name in CANDIDATES:
        terms = MODELS[name]
        if sure - set(terms) - ({"c"} if "tilt" in terms else set()):
            continue
        fits[name] = found = fit_model(terms)
        sure = sure or beyond_doubt(found, sizes)
        k = len(found.layout.names)
        bic = count * np.log(max(found.chi2, 1e-300) / count) + k * np.log(count)
        table.append(Choice(name, k, float(np.sqrt(found.chi2 / count)), float(bic)))
    return min(table, key=lambda row: row.bic).model, fits, table
