"""The lens model that predicts best where the rig is used."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.calibration.observations import Observations
from wavefield.calibration.parameters import TERMS
from wavefield.calibration.predicted_errors import at_points, volume
from wavefield.errors import CalibrationError
from wavefield.rig.lens import LENS, Array

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
EQUIVALENT_RATIO = 1.05  # of expected errors: models within it count as equally good
SIGNIFICANCE = 10.0  # standard deviations from a perfect camera's value: a term that is needed


@dataclass(frozen=True)
class Choice:
    """One row of the comparison."""

    model: str  # Name in `MODELS`
    parameters: int  # Free parameters of the joint fit
    rms: float  # Rms of the residuals in units of the stated uncertainty
    bic: float  # Bayes' information criterion
    # Expected error of a pixel where the rig will be used, px: among the models within five per cent of the
    # smallest, the one with the fewest parameters is chosen
    expected: float


def terms_of(model: str | Sequence[str]) -> tuple[str, tuple[str, ...]] | None:
    """Name and free terms of a model given by name or as a list of terms; None for ``auto``."""
    if isinstance(model, str):
        if model == "auto":
            return None
        if model not in MODELS:
            raise CalibrationError(f"camera model {model!r} is unknown; use auto, {', '.join(MODELS)}")
        return model, MODELS[model]
    unknown = [term for term in model if term not in TERMS]
    if unknown or "f" not in model:
        raise CalibrationError(f"camera model {list(model)} is not made of f, {', '.join(list(TERMS)[1:])}")
    return " ".join(model), tuple(model)


def significant_terms(fit: Fit, sizes: Sequence[tuple[int, int]]) -> set[str]:
    """Terms that some camera needs: ten times their uncertainty away from a perfect camera's."""
    std = np.sqrt(np.diag(fit.covariance))
    needed = set()
    for c, columns in enumerate(fit.layout.lens):
        perfect = {"cx": (sizes[c][0] - 1) / 2, "cy": (sizes[c][1] - 1) / 2, "k1": 0.0}
        for k, column in columns:
            if column in perfect:
                away = abs(fit.geometry.lens[c, LENS.index(column)] - perfect[column])
                if away > SIGNIFICANCE * std[k]:
                    needed.add("k1" if column == "k1" else "c")
    return needed


def choose(
    fit_model: Callable[[tuple[str, ...]], Fit],
    observations: Observations,
    level: bool,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[str, dict[str, Fit], list[Choice]]:
    """Fit the candidates and choose the one that predicts best within `predicted_errors.volume`.
    The model of the fewest parameters among those with nearly the least expected error of a pixel is chosen.
    """
    o, count = observations, 2 * len(observations)
    fits: dict[str, Fit] = {}
    bic: dict[str, float] = {}
    needed: set[str] = set()
    all_fisheye = False
    for done, name in enumerate(CANDIDATES):
        if progress:
            progress(done, len(CANDIDATES))
        terms = MODELS[name]
        if needed - set(terms) - ({"c"} if "tilt" in terms else set()):
            continue
        if fits and all_fisheye and ("p" in terms or "tilt" in terms):
            continue  # which these lenses have not
        fits[name] = result = fit_model(terms)
        all_fisheye = bool(result.geometry.lens[:, LENS.index("fisheye")].all())
        needed = needed or significant_terms(result, o.sizes)
        k = len(result.layout.names)
        bic[name] = float(count * np.log(max(result.chi2, 1e-300) / count) + k * np.log(count))
    if progress:
        progress(len(CANDIDATES), len(CANDIDATES))
    reference = min(bic, key=lambda name: bic[name])
    # BIC alone is dominated by the images' edges: it may select a lens that fits them a little better and
    # predicts the middle ten times worse. A focused criterion (Claeskens and Hjort 2003) in place of it:
    expected = _expected(fits, reference, o, volume(o, fits[reference], level))
    table = [
        Choice(name, len(f.layout.names), float(np.sqrt(f.chi2 / count)), bic[name], expected[name])
        for name, f in fits.items()
    ]
    near = [row for row in table if row.expected <= EQUIVALENT_RATIO * min(expected.values())]
    return min(near, key=lambda row: row.parameters).model, fits, table


def _expected(fits: Mapping[str, Fit], reference: str, o: Observations, points: Array) -> dict[str, float]:
    """Expected error of a pixel at points by each model, px."""
    pixel: dict[str, Array] = {}
    variance: dict[str, float] = {}
    for name, f in fits.items():
        pixel[name], J, _ = at_points(o, f, points)
        variance[name] = float(np.einsum("cnip,pq,cniq->", J, f.covariance, J, optimize=True))
    size = pixel[reference].size
    out = {}
    for name in fits:
        apart = float(np.sum((pixel[name] - pixel[reference]) ** 2))
        # the model's own error: its difference from BIC's choice, less what the noise of the two differs by
        own = max(0.0, apart - abs(variance[name] - variance[reference]))
        out[name] = float(np.sqrt((variance[name] + own) / size))
    return out
