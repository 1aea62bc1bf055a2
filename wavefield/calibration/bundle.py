"""The joint fit: all cameras and all poses of the target at once (bundle adjustment)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from wavefield.calibration.least_squares import Whitener, huber, minimise, normal_matrix
from wavefield.calibration.observations import Geometry, Observations
from wavefield.calibration.parameters import (
    ParameterLayout,
    layout,
    linearised,
    moved,
    predict,
    terms_of_kind,
)
from wavefield.rig.lens import Array
from wavefield.robust import robust_std

HUBER_LIMIT = 4.0  # standard deviations beyond which the loss grows linearly


@dataclass(frozen=True)
class Fit:
    """Result of a joint fit."""

    geometry: Geometry  # Cameras, poses and node offsets
    layout: ParameterLayout  # The parameters
    covariance: Array  # (p, p): Of the parameters, scaled by the residuals
    residual: Array  # (n, 2): Observed less predicted, px
    scale: float  # Robust standard deviation of the residuals over their stated uncertainty
    chi2: float  # Robust sum of squares of the independent residuals, in units of the stated uncertainty


def fit(
    observations: Observations,
    start: Geometry,
    models: Sequence[Sequence[str]],
    reference: int,
    flat: Sequence[int] = (),
    target_std: float = 0.0,
    noise_scale: float | None = None,
    placed: Sequence[int] = (),
) -> Fit:
    """Fit cameras and poses to all observations; target_std (metres) is the prior of the nodes' offsets.
    Levenberg-Marquardt with the analytic Jacobian and Huber's loss at four standard deviations.
    """
    o = observations
    models = [terms_of_kind(own, bool(lens[-1])) for own, lens in zip(models, start.lens, strict=True)]
    plan = layout(o, models, reference, flat, placed)
    start = replace(start, offset=np.zeros_like(start.offset))
    inverse = 1.0 / np.repeat(o.std, 2)
    whitener: Whitener | None = None

    def residual(x: Array) -> Array:
        r = (predict(moved(start, plan, x), o) - o.pixel).ravel() * inverse
        return whitener(r) if whitener else r

    def with_jacobian(x: Array) -> tuple[Array, Array]:
        pixel, J, _ = linearised(start, plan, x, o)
        r, J = (pixel - o.pixel).ravel() * inverse, J.reshape(2 * len(o), -1)
        J *= inverse[:, None]
        return (whitener(r), whitener(J)) if whitener else (r, J)

    x = np.zeros(len(plan.names))
    stated_limit = HUBER_LIMIT * noise_scale if noise_scale else None
    # the limit depends on the residuals, and the whitening on the geometry: a coarse fit first
    for tolerance in (1e-2, 1e-7):
        if target_std > 0.0:
            whitener = Whitener(o.node, linearised(start, plan, x, o)[2] / o.std[:, None, None], target_std)
        x, limit = minimise(residual, with_jacobian, x, stated_limit, tolerance)
    r, J = with_jacobian(x)
    # exact points leave no residuals at all, but a covariance of zero is of no use
    scale = max(robust_std(r) * np.sqrt(len(r) / max(len(r) - len(x), 1)), 1e-6)
    weight = np.minimum(1.0, limit / np.maximum(np.abs(r), 1e-300))
    normal = normal_matrix(J, weight)
    d = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    units = np.outer(d, d)
    covariance = scale**2 * np.linalg.pinv(normal * units, rcond=1e-15, hermitian=True) * units
    geometry = moved(start, plan, x)
    predicted = predict(geometry, o)
    if whitener:
        offset = np.zeros_like(start.offset)
        estimate = whitener.offsets((o.pixel - predicted).ravel() * inverse)
        offset[: len(estimate)] = estimate
        geometry = replace(geometry, offset=offset)
        predicted = predict(geometry, o)
    return Fit(geometry, plan, covariance, o.pixel - predicted, float(scale), huber(r, limit))
