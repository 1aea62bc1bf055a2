"""Exponents of spectra: E ~ k^-n or omega^-n over a range, with intervals."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.waves.estimation.degrees_of_freedom import hann_correlation
from wavefield.waves.estimation.inputs import described, is_field, takes
from wavefield.waves.estimation.rings import rings
from wavefield.waves.spectra.field_spectra import E_k, E_omega, a_komega

Array = NDArray[Any]

MIN_LINES = 5
MIN_RATIO = 1.3  # of the ends of the range
CHANCE = 0.05  # outside the interval


def _one_axis(given: Any, name: str) -> tuple[Any, dict[str, Any]]:
    """A spectrum over k or omega with its degrees of freedom, as it is; else what E(k, omega) is made of."""
    has = isinstance(given, xr.Dataset) and {"E", "dof"} <= {*given.data_vars}
    if has and given["E"].dims in (("k",), ("omega",)):
        return given, {}
    if is_field(given) or (has and set(given["E"].dims) == {"omega", "k"}):
        return a_komega(given, name)
    raise CubeError(
        f"{name} needs a field over time, y and x (for example cube.w), or the result of"
        f" wavefield.komega, wavefield.E_k or wavefield.E_omega, got {described(given)}"
    )


@takes(_one_axis)
def spectral_slope(
    field: xr.DataArray | xr.Dataset,
    lowest: float,
    highest: float,
    *,
    axis: str | None = None,
) -> xr.Dataset:
    """Exponent of a spectrum over a range of frequencies or wavenumbers, with its 95 % interval.

    Parameters
    ----------
    field : DataArray or Dataset
        A variable of a cube over (time, y, x), or the result of `komega`, `E_omega` or `E_k`.
    lowest, highest : float
        Ends of the range: Hz of E(omega), rad/m of E(k).
    axis : {"omega", "k"}, optional
        Axis of the spectrum; by default that which the spectrum has, or omega.

    Returns
    -------
    Dataset
        ``slope``, the exponent of E ~ x^slope; ``slope_std`` and the ends of its 95 % interval, ``slope_low``
        and ``slope_high``; ``level``, E in the middle of the range (geometric); ``curvature``, the second
        derivative of log E over log x, and ``curvature_std``; ``misfit``, the rms deviation from the power
        law over that which the degrees of freedom let expect.

    Raises
    ------
    CubeError
        If the range holds fewer than five lines or its ends are nearer than a factor of 1.3, or the spectrum
        is zero there.

    Notes
    -----
    log E by generalised least squares, with the variance 2 / nu of each line and the correlation of lines
    that Hann windows make, and the mean of the logarithm of chi-squared taken off (digamma). Where the misfit
    exceeds one, no power law describes the range; the uncertainty is larger by that. A spectrum blurred by
    windows and floors of noise are not corrected for: choose the range inside both.

    Examples
    --------
    White noise is flat over omega, and grows as k over k.

    >>> rng = np.random.default_rng(0)
    >>> axes = {"time": np.arange(512) * 0.05, "y": np.arange(40) * 0.05, "x": np.arange(48) * 0.05}
    >>> w = xr.DataArray(rng.standard_normal((512, 40, 48)), axes, ("time", "y", "x"))
    >>> flat, rising = spectral_slope(w, 1.0, 8.0), spectral_slope(w, 10.0, 50.0, axis="k")
    >>> bool(abs(flat.slope) < 0.1), bool(abs(rising.slope - 1) < 0.1)
    (True, True)
    """
    spectrum = field
    if "dof" not in field or set(field["E"].dims) == {"omega", "k"}:
        spectrum = E_k(field) if axis == "k" else E_omega(field)
    own = str(spectrum["E"].dims[0])
    if axis not in (None, own):
        raise CubeError(f"the spectrum is over {own}: leave out axis={axis!r}, or give the field")
    x = spectrum[own].values / (2 * np.pi if own == "omega" else 1.0)
    unit = "Hz" if own == "omega" else "rad/m"
    chosen = np.flatnonzero((x >= lowest) & (x <= highest) & (x > 0))
    if chosen.size < MIN_LINES or not highest >= MIN_RATIO * lowest > 0:
        raise CubeError(
            f"{lowest:g} to {highest:g} {unit} holds {chosen.size} lines {x[2] - x[1]:.2g} {unit} apart: five"
            f" at least, over a factor of {MIN_RATIO}, are needed"
        )
    energy, dof = (spectrum[name].values[chosen].astype(float) for name in ("E", "dof"))
    if not ((energy > 0).all() and np.isfinite(dof).all()):
        raise CubeError(
            f"the spectrum is not positive between {lowest:g} and {highest:g} {unit}: choose another"
        )
    return _fitted(
        x[chosen], energy, dof, _correlation(field, own, chosen), spectrum["E"].attrs.get("units", "")
    )


def _correlation(field: Any, axis: str, chosen: Array) -> Array:
    """Correlation of the powers of lines, or of rings, (n, n)."""
    if axis == "omega" or "nodes" not in field.attrs:
        return hann_correlation(chosen.size)
    step = float(field["k"][1] - field["k"][0])
    overlap = rings(*field.attrs["nodes"], *field.attrs["node_step"], step).overlap[np.ix_(chosen, chosen)]
    size = np.sqrt(np.diag(overlap))
    return np.asarray(overlap / np.outer(size, size))


def _least_squares(design: Array, values: Array, inverse: Array) -> tuple[Array, Array, float]:
    """Coefficients, their covariance, and chi-squared over its degrees of freedom."""
    covariance = np.linalg.inv(design.T @ inverse @ design)
    found = covariance @ design.T @ inverse @ values
    rest = values - design @ found
    return found, covariance, float(rest @ inverse @ rest) / (values.size - design.shape[1])


def _fitted(x: Array, energy: Array, dof: Array, correlation: Array, units: str) -> xr.Dataset:
    from scipy.special import digamma, polygamma

    half = np.maximum(dof, 1) / 2
    values = np.log(energy) - (digamma(half) - np.log(half))
    std = np.sqrt(polygamma(1, half))
    inverse = np.linalg.inv(correlation * np.outer(std, std))
    middle = np.sqrt(x[0] * x[-1])
    log_x = np.log(x / middle)
    found, covariance, chi = _least_squares(np.column_stack([np.ones(x.size), log_x]), values, inverse)
    more = max(chi, 1.0)
    bent, of_bent, _ = _least_squares(np.column_stack([np.ones(x.size), log_x, log_x**2]), values, inverse)
    slope_std = float(np.sqrt(covariance[1, 1] * more))
    # chi-squared itself is uncertain where it widens the interval
    reach = float(stats.t.ppf(1 - CHANCE / 2, x.size - 2) if chi > 1 else stats.norm.ppf(1 - CHANCE / 2))
    out = {
        "slope": float(found[1]),
        "slope_std": slope_std,
        "slope_low": float(found[1]) - reach * slope_std,
        "slope_high": float(found[1]) + reach * slope_std,
        "level": float(np.exp(found[0])),
        "curvature": float(2 * bent[2]),
        "curvature_std": float(2 * np.sqrt(of_bent[2, 2] * more)),
        "misfit": float(np.sqrt(chi)),
    }
    result = annotate(xr.Dataset({name: ((), value) for name, value in out.items()}), "slopes")
    result["level"].attrs["units"] = units
    return result.assign_attrs(lowest=float(x[0]), highest=float(x[-1]))
