"""Current by depth: short waves are shifted by the current near the surface, long ones by that below."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion
from wavefield.waves.dispersion_relation.current_used import CurrentUsed
from wavefield.waves.estimation.inputs import takes
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.products import Product, register
from wavefield.waves.spectra.plane_input import a_dataset_with

Array = NDArray[Any]

MIN_POINTS = 12  # in a band
MAX_CONDITION = 1e4  # of the normal equations of a band: those of waves of one direction exceed it
ROUNDS = 2  # the first gives the variation of the current within a band


@dataclass(frozen=True)
class ShearSettings:
    """Bands and degree of the current by depth.

    Parameters
    ----------
    bands : int
        Bands of wavenumber.
    degree : int
        Highest degree of the polynomial in depth; the data choose among 0 to this.
    """

    bands: int = 10
    degree: int = 3


@takes(a_dataset_with(("ridge_k", "ridge_omega", "ridge_angle", "ridge_weight", "depth"), "fit_dispersion"))
def current_by_depth(
    fit: xr.Dataset,
    *,
    surface: tuple[float, float] | None = None,
    surface_std: float = 0.002,
    gamma: float | None = None,
    settings: ShearSettings | None = None,
) -> xr.Dataset:
    """Current at depth from the Doppler shift of each band of wavenumbers.

    Parameters
    ----------
    fit : Dataset
        The result of `fit_dispersion`.
    surface : tuple of float, optional
        Mean of u and v at the surface, m/s: the point at depth 0.
    surface_std : float
        Its standard uncertainty, m/s.
    gamma : float, optional
        Surface tension over density, m3/s2; that of clean water if not given.
    settings : ShearSettings, optional
        Bands and degree.

    Returns
    -------
    Dataset
        ``doppler_x``, ``doppler_y`` and their ``_std`` (k_band), m/s, the current that shifts the waves of a
        band; ``effective_depth`` (k_band), m; ``current_x``, ``current_y`` and their ``_std`` (z), m/s, over
        the depths that the waves reach; attribute ``degree``.

    Raises
    ------
    CubeError
        If fewer than three bands have enough points.

    Notes
    -----
    Waves of wavenumber k are shifted by 2 k int U(z) exp(2 k z) dz (Stewart and Joy 1974). A polynomial
    sum p_n z^n through these values at z = -1 / 2k comes from the current sum (p_n / n!) z^n (Smeltzer et al.
    2019). The degree is that of the least Akaike criterion. Within a band points are moved to its centre
    along the polynomial of a first round. Uncertainties join the residuals of the points within each band,
    the misfit of the polynomial and the change by one degree more.

    Examples
    --------
    A current of 0.1 m/s at the surface, less by 0.02 m/s at a depth of 10 cm.

    >>> k, angle = (part.ravel() for part in np.meshgrid(np.linspace(8, 60, 40), np.arange(16) * np.pi / 8))
    >>> omega = dispersion(k) + k * np.cos(angle) * (0.1 - 0.2 / (2 * k))
    >>> points = {"k": k, "angle": angle, "omega": omega, "weight": np.ones(k.size)}
    >>> fit = xr.Dataset({f"ridge_{name}": ("point", values) for name, values in points.items()})
    >>> current = current_by_depth(fit.assign(depth=np.inf))
    >>> print(f"{np.interp(-0.02, current.z, current.current_x):.3f} m/s at a depth of 2 cm")
    0.096 m/s at a depth of 2 cm
    >>> bool(abs(current.current_y).max() < 0.001)
    True
    """
    settings = settings or ShearSettings()
    gamma = GAMMA if gamma is None else gamma
    profile = np.zeros((1, 2))
    for _ in range(ROUNDS):
        k, shift, std = _doppler(fit, gamma, settings.bands, profile)
        if k.size < 3:
            raise CubeError(
                "too few points of the dispersion relation were found: choose a wider band or a longer record"
            )
        z_of_band = -1 / (2 * k)
        if surface is not None:
            z_of_band = np.append(z_of_band, 0.0)
            shift = np.vstack([shift, surface])
            std = np.vstack([std, [surface_std, surface_std]])
        fits, degree = _polynomials(z_of_band, shift, std, settings.degree)
        profile = fits[degree][0]
    z = np.linspace(z_of_band.min(), z_of_band.max(), 41)
    coefficients, covariances = fits[degree]
    powers = _powers(z, degree)
    next_degree = _powers(z, degree + 1) @ fits[degree + 1][0]
    out: dict[str, Any] = {"effective_depth": ("k_band", 1 / (2 * k))}
    for i, name in enumerate("xy"):
        out[f"doppler_{name}"] = ("k_band", shift[: k.size, i])
        out[f"doppler_{name}_std"] = ("k_band", std[: k.size, i])
        current = powers @ coefficients[:, i]
        out[f"current_{name}"] = ("z", current)
        chance = np.sqrt(np.einsum("zi,ij,zj->z", powers, covariances[i], powers))
        # the change by one degree more: no current is a polynomial
        out[f"current_{name}_std"] = ("z", np.hypot(chance, next_degree[:, i] - current))
    return annotate(xr.Dataset(out, {"k_band": k, "z": z}, {"degree": degree}), "shear")


def _powers(z: Array, degree: int) -> Array:
    """z^n / n!, (z, n)."""
    factorials = np.cumprod(np.maximum(np.arange(degree + 1), 1)).astype(float)
    return np.asarray(z[:, None] ** np.arange(degree + 1) / factorials)


def _doppler(points: xr.Dataset, gamma: float, bands: int, profile: Array) -> tuple[Array, Array, Array]:
    """Wavenumbers (bands,), Doppler velocity of each band and its standard uncertainty, (bands, 2).
    `profile` (degree + 1, 2), coefficients over -1 / 2k, moves each point to the centre of its band.
    """
    k, angle, omega, weight = (
        points[f"ridge_{name}"].values.astype(float) for name in ("k", "angle", "omega", "weight")
    )
    # the variation within a band would otherwise count as error
    current_along = (omega - dispersion(k, float(points["depth"]), gamma)) / k
    # each line on its own scale: energy falls by decades
    lines, line = np.unique(omega, return_inverse=True)
    strongest = np.zeros(lines.size)
    np.maximum.at(strongest, line, weight)
    weight = weight / strongest[line]
    edges = np.quantile(k, np.linspace(0, 1, bands + 1))
    rows = []
    for low, high in pairwise(edges):
        inside = (k >= low) & (k < high)
        if inside.sum() < MIN_POINTS:
            continue
        heading = np.stack([np.cos(angle[inside]), np.sin(angle[inside])], axis=1)
        w = weight[inside]
        normal = heading.T @ (w[:, None] * heading)
        if np.linalg.cond(normal) > MAX_CONDITION:
            continue
        centre = np.average(k[inside], weights=w)
        powers = [(-1 / (2 * at)) ** np.arange(len(profile)) for at in (k[inside][:, None], centre)]
        along = current_along[inside] - (heading * ((powers[0] - powers[1]) @ profile)).sum(axis=1)
        velocity = np.linalg.solve(normal, heading.T @ (w * along))
        residual = along - heading @ velocity
        inverse = np.linalg.inv(normal)
        # from the residuals; a line shares its error with the next: half of the points count
        gradients = heading * (w * residual)[:, None]
        covariance = 2 * inverse @ (gradients.T @ gradients) @ inverse
        rows.append((centre, *velocity, *np.sqrt(np.diag(covariance))))
    table = np.array(rows).reshape(-1, 5)
    return table[:, 0], table[:, 1:3], np.maximum(table[:, 3:5], 1e-5)


def _polynomials(
    z: Array, values: Array, std: Array, highest: int
) -> tuple[list[tuple[Array, list[Array]]], int]:
    """Coefficients (degree + 1, 2) and covariances of all degrees to one above the highest, and the best.
    The best degree is that of the least Akaike criterion for the given errors.
    """
    fits: list[tuple[Array, list[Array]]] = []
    criteria: list[float] = []
    for degree in range(min(highest + 1, z.size - 1) + 1):
        basis = z[:, None] ** np.arange(degree + 1)
        columns, covariances, misfit = [], [], 0.0
        for i in (0, 1):
            scaled = basis / std[:, i : i + 1]
            normal = scaled.T @ scaled
            coefficients = np.linalg.solve(normal, scaled.T @ (values[:, i] / std[:, i]))
            residual = (values[:, i] - basis @ coefficients) / std[:, i]
            misfit += float(residual @ residual)
            columns.append(coefficients)
            free = max(z.size - degree - 1, 1)
            covariances.append(np.linalg.inv(normal) * max(float(residual @ residual) / free, 1.0))
        fits.append((np.stack(columns, axis=1), covariances))
        criteria.append(misfit + 2 * 2 * (degree + 1))
    return fits, int(np.argmin(criteria[:-1]))


def _group(fit: xr.Dataset, moments: xr.Dataset, used: CurrentUsed, gamma: float, welch: Welch) -> xr.Dataset:
    drift = moments["mean"] / welch.record.dt
    surface = float(drift.sel(quantity="dx")), float(drift.sel(quantity="dy"))
    return current_by_depth(fit, surface=surface, gamma=gamma).assign_attrs(used.attrs)


register(
    Product(
        "shear",
        ("dispersion_fit", "moments", "fitted_current", "gamma", "welch"),
        _group,
        group="shear",
        without="No current by depth",
        cost=2,
    )
)
