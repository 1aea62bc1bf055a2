"""Current by depth: short waves feel the water near the surface, long ones that further down."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion

Array = NDArray[Any]

_LEAST = 12  # points of the ridge in a band
_ROUNDS = 2  # the first does not know yet how the current varies within a band


@dataclass(frozen=True)
class ShearSettings:
    """How the current by depth is found.

    Parameters
    ----------
    bands : int
        Bands of wavenumber.
    degree : int
        Highest degree of the polynomial in depth; the data choose among 0 to this.
    """

    bands: int = 10
    degree: int = 3


def current_by_depth(
    ridge: xr.Dataset,
    *,
    surface: tuple[float, float] | None = None,
    surface_std: float = 0.002,
    gamma: float | None = None,
    settings: ShearSettings | None = None,
) -> xr.Dataset:
    """Current at depth from the Doppler shift of each band of wavenumbers.

    Parameters
    ----------
    ridge : Dataset
        As `fit_dispersion` gives it.
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
        ``doppler_x``, ``doppler_y`` and their ``_std`` (k_band), m/s, the current that waves of a band feel;
        ``effective_depth`` (k_band), m; ``current_x``, ``current_y`` and their ``_std`` (z), m/s, over the
        depths that waves reach; attribute ``degree``.

    Raises
    ------
    CubeError
        If fewer than three bands hold enough of the ridge.

    Notes
    -----
    Waves of wavenumber k feel 2 k int U(z) exp(2 k z) dz (Stewart and Joy 1974). A polynomial sum p_n z^n
    through these values at z = -1 / 2k comes from the current sum (p_n / n!) z^n (Smeltzer et al. 2019). The
    degree is that of the least Akaike criterion. Within a band points are taken to its centre along the
    polynomial of a first round. Uncertainties join the scatter of the ridge within each band, the misfit of
    the polynomial and what one degree more would change.

    Examples
    --------
    A current of 0.1 m/s at the surface, less by 0.02 m/s at a depth of 10 cm.

    >>> k, angle = (part.ravel() for part in np.meshgrid(np.linspace(8, 60, 40), np.arange(16) * np.pi / 8))
    >>> felt = 0.1 - 0.2 / (2 * k)
    >>> omega = dispersion(k) + k * np.cos(angle) * felt
    >>> points = {"k": k, "angle": angle, "omega": omega, "weight": np.ones(k.size)}
    >>> ridge = xr.Dataset({f"ridge_{name}": ("point", values) for name, values in points.items()})
    >>> current = current_by_depth(ridge.assign(depth=np.inf))
    >>> print(f"{np.interp(-0.02, current.z, current.current_x):.3f} m/s at a depth of 2 cm")
    0.096 m/s at a depth of 2 cm
    >>> bool(abs(current.current_y).max() < 0.001)
    True
    """
    settings = settings or ShearSettings()
    gamma = GAMMA if gamma is None else gamma
    felt = np.zeros((1, 2))
    for _ in range(_ROUNDS):
        k, shift, std = _doppler(ridge, gamma, settings.bands, felt)
        if k.size < 3:
            raise CubeError(
                "the ridge holds too few points for a current by depth: choose a wider band or a longer"
                " record"
            )
        places = -1 / (2 * k)
        if surface is not None:
            places = np.append(places, 0.0)
            shift = np.vstack([shift, surface])
            std = np.vstack([std, [surface_std, surface_std]])
        fits, degree = _polynomials(places, shift, std, settings.degree)
        felt = fits[degree][0]
    z = np.linspace(places.min(), places.max(), 41)
    coefficients, covariances = fits[degree]
    powers = _powers(z, degree)
    further = _powers(z, degree + 1) @ fits[degree + 1][0]
    out: dict[str, Any] = {"effective_depth": ("k_band", 1 / (2 * k))}
    for i, name in enumerate("xy"):
        out[f"doppler_{name}"] = ("k_band", shift[: k.size, i])
        out[f"doppler_{name}_std"] = ("k_band", std[: k.size, i])
        current = powers @ coefficients[:, i]
        out[f"current_{name}"] = ("z", current)
        spread = np.sqrt(np.einsum("zi,ij,zj->z", powers, covariances[i], powers))
        # what one degree more would change: no current is a polynomial
        out[f"current_{name}_std"] = ("z", np.hypot(spread, further[:, i] - current))
    return annotate(xr.Dataset(out, {"k_band": k, "z": z}, {"degree": degree}), "shear")


def _powers(z: Array, degree: int) -> Array:
    # z^n / n!, (z, n)
    factorials = np.cumprod(np.maximum(np.arange(degree + 1), 1)).astype(float)
    return np.asarray(z[:, None] ** np.arange(degree + 1) / factorials)


def _doppler(ridge: xr.Dataset, gamma: float, bands: int, felt: Array) -> tuple[Array, Array, Array]:
    # wavenumbers (bands,), Doppler velocity and its standard uncertainty (bands, 2); `felt` are coefficients
    # (degree + 1, 2) of what waves feel over -1 / 2k: within a band it takes each point to the band's centre,
    # or its variation would count as scatter
    k, angle, omega, weight = (
        ridge[f"ridge_{name}"].values.astype(float) for name in ("k", "angle", "omega", "weight")
    )
    depth = float(ridge["depth"])
    apparent = (omega - dispersion(k, depth, gamma)) / k  # of the current along the wave
    # each line on its own scale: energy falls by decades
    lines, number = np.unique(omega, return_inverse=True)
    top = np.zeros(lines.size)
    np.maximum.at(top, number, weight)
    weight = weight / top[number]
    edges = np.quantile(k, np.linspace(0, 1, bands + 1))
    found = []
    for low, high in pairwise(edges):
        inside = (k >= low) & (k < high)
        if inside.sum() < _LEAST:
            continue
        heading = np.stack([np.cos(angle[inside]), np.sin(angle[inside])], axis=1)
        w = weight[inside]
        normal = heading.T @ (w[:, None] * heading)
        if np.linalg.cond(normal) > 1e4:
            continue
        centre = np.average(k[inside], weights=w)
        powers = [(-1 / (2 * at)) ** np.arange(len(felt)) for at in (k[inside][:, None], centre)]
        along = apparent[inside] - (heading * ((powers[0] - powers[1]) @ felt)).sum(axis=1)
        velocity = np.linalg.solve(normal, heading.T @ (w * along))
        left = along - heading @ velocity
        inverse = np.linalg.inv(normal)
        # from the scatter of the points; a line shares its error with the next: half of them count
        pulls = heading * (w * left)[:, None]
        meat = pulls.T @ pulls
        covariance = 2 * inverse @ meat @ inverse
        found.append((centre, *velocity, *np.sqrt(np.diag(covariance))))
    rows = np.array(found).reshape(-1, 5)
    return rows[:, 0], rows[:, 1:3], np.maximum(rows[:, 3:5], 1e-5)


def _polynomials(
    places: Array, values: Array, std: Array, highest: int
) -> tuple[list[tuple[Array, list[Array]]], int]:
    # coefficients (degree + 1, 2) and their covariances of all degrees, and which is best by Akaike's
    # criterion for known errors; one more than may be best
    fits: list[tuple[Array, list[Array]]] = []
    criteria: list[float] = []
    for degree in range(min(highest + 1, places.size - 1) + 1):
        basis = places[:, None] ** np.arange(degree + 1)
        columns, covariances, misfit = [], [], 0.0
        for i in (0, 1):
            scaled = basis / std[:, i : i + 1]
            normal = scaled.T @ scaled
            solved = np.linalg.solve(normal, scaled.T @ (values[:, i] / std[:, i]))
            left = (values[:, i] - basis @ solved) / std[:, i]
            misfit += float(left @ left)
            columns.append(solved)
            free = max(places.size - degree - 1, 1)
            covariances.append(np.linalg.inv(normal) * max(float(left @ left) / free, 1.0))
        fits.append((np.stack(columns, axis=1), covariances))
        criteria.append(misfit + 2 * 2 * (degree + 1))
    return fits, int(np.argmin(criteria[:-1]))
