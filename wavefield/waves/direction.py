"""Where the waves go: the directional spectrum on the ridge, and how isotropic the sea is."""

import numpy as np
import xarray as xr

from wavefield.errors import CubeError
from wavefield.variables import annotate
from wavefield.water import GAMMA, dispersion, wavenumber
from wavefield.waves import rings
from wavefield.waves.windows import interval

_HALF_WIDTH, _LEAST_CELLS = 0.22, 2.2  # of the ring around the ridge: relative, and in cells


def directions(
    density: xr.DataArray,
    frequency: list[float] | np.ndarray,
    depth: float = np.inf,
    *,
    sectors: int = 24,
    dof: float | None = None,
    gamma: float = GAMMA,
    bandwidth: float = 0.2,
) -> xr.Dataset:
    """Directional spectrum of the waves on the ridge at some frequencies.

    Parameters
    ----------
    density : DataArray, (omega, ky, kx)
        Spectrum of z or w.
    frequency : array_like
        Frequencies, Hz.
    depth : float
        Depth of the water, m.
    sectors : int
        Number of sectors of the circle.
    dof : float, optional
        Degrees of freedom of a cell; needed for ``dof``, ``low``, ``high``.
    gamma : float
        Surface tension over density, m3/s2.
    bandwidth : float
        Width of the band around each frequency, Hz.

    Returns
    -------
    Dataset
        ``D`` (frequency, theta): density over the direction of propagation, its integral over theta is 1;
        ``dof``, ``low``, ``high`` (frequency, theta); ``direction``, ``spread`` (frequency): mean direction
        and directional spread, rad; ``isotropy`` (frequency): 1 - the larger modulus of the first two
        harmonics of D, 1 for an isotropic sea, 0 for a single direction.

    Raises
    ------
    CubeError
        If a frequency lies beyond the Nyquist frequency.

    Notes
    -----
    Cells near the ridge are shared between sectors by area (8 x 8 parts); the k plane's own coverage of each
    sector is divided out, so a rectangle of nodes does not look like a direction. The spread is
    sqrt(2 (1 - |int D exp(i theta) dtheta|)), the resolution taken off: a Hann window of length L blurs k by
    (2 pi / L) / sqrt(3), cells and sectors by their width over sqrt(12). D itself keeps that blur.
    """
    frequency = np.atleast_1d(np.asarray(frequency, float))
    lines = density["omega"].values / (2 * np.pi)
    if frequency.max() > lines[-1]:
        raise CubeError(f"{frequency.max():g} Hz is outside the spectrum, which ends at {lines[-1]:g} Hz")
    ky, kx = density["ky"].values, density["kx"].values
    cell = max(float(ky[1] - ky[0]), float(kx[1] - kx[0]))
    n = rings.SUPERSAMPLING
    part = (np.arange(n) + 0.5) / n - 0.5
    sub_y = ky[:, None, None, None] + (part * (ky[1] - ky[0]))[:, None, None]
    sub_x = kx[:, None] + part * (kx[1] - kx[0])
    radius = np.hypot(sub_y, sub_x)  # (ky, part, kx, part)
    width = 2 * np.pi / sectors
    sector = np.floor((np.arctan2(sub_y, sub_x) % (2 * np.pi)) / width).astype(int) % sectors
    flat_cell = np.broadcast_to(np.arange(ky.size * kx.size).reshape(ky.size, 1, kx.size, 1), radius.shape)

    density_rows, dof_rows, centres = [], [], []
    for f in frequency:
        chosen = np.flatnonzero(np.abs(lines - f) <= bandwidth / 2 + 1e-9)
        if not chosen.size:
            chosen = np.array([np.abs(lines - f).argmin()])
        energy = density.isel(omega=chosen).mean("omega").values.astype(float)
        centre = float(wavenumber(2 * np.pi * f, depth, gamma))
        centres.append(centre)
        ring = np.abs(radius - centre) < max(_HALF_WIDTH * centre, _LEAST_CELLS * cell)
        index = sector[ring] * energy.size + flat_cell[ring]
        shares = np.bincount(index, minlength=sectors * energy.size).reshape(sectors, -1) / n**2
        area = shares.sum(axis=1)
        level = np.divide(shares @ energy.ravel(), area, out=np.zeros(sectors), where=area > 0)
        total = level.sum() * width
        density_rows.append(level / total if total > 0 else np.full(sectors, np.nan))
        # Hann windows: 3.78 neighbouring cells and about two lines count as one
        independent = np.maximum(area / 3.78, 1) * max(chosen.size / 1.94, 1)
        dof_rows.append((np.nan if dof is None else dof) * independent)
    theta = (np.arange(sectors) + 0.5) * width
    values = np.array(density_rows)
    first, second = ((values * np.exp(1j * m * theta)).sum(axis=1) * width for m in (1, 2))
    mean = np.angle(first)
    # variance of a component of k: window 1/3 and cell 1/12, in cells; across the mean direction
    across = np.hypot((ky[1] - ky[0]) * np.cos(mean), (kx[1] - kx[0]) * np.sin(mean)) / np.array(centres)
    blur = 5 / 12 * across**2 + width**2 / 12
    spread = np.sqrt(np.maximum(2 * (1 - np.abs(first)) - blur, 0))
    degrees = np.array(dof_rows)
    low, high = interval(degrees)
    dims = ("frequency", "theta")
    out = xr.Dataset(
        {
            "D": (dims, values),
            "dof": (dims, degrees),
            "low": (dims, low),
            "high": (dims, high),
            "direction": ("frequency", mean % (2 * np.pi)),
            "spread": ("frequency", spread),
            "isotropy": ("frequency", 1 - np.maximum(np.abs(first), np.abs(second))),
        },
        {"frequency": ("frequency", frequency), "theta": ("theta", theta)},
    )
    return annotate(out, "direction")


def direction_group(
    density: xr.DataArray, chosen: list[int], depth: float, gamma: float, dof: float
) -> xr.Dataset:
    """Directions at the frequencies of the maps, isotropy at all.

    Parameters
    ----------
    density : DataArray, (omega, ky, kx)
        Spectrum of w.
    chosen : list of int
        Lines of the maps.
    depth, gamma : float
        Depth, m, and surface tension over density, m3/s2, of the water.
    dof : float
        Degrees of freedom of a cell.

    Returns
    -------
    Dataset
        ``D`` and its interval (omega_map, theta), ``direction``, ``spread`` (omega_map), ``isotropy``
        (omega).
    """
    lines = density["omega"].values / (2 * np.pi)
    out = directions(density, lines[chosen], depth, dof=dof, gamma=gamma).drop_vars("isotropy")
    out = out.rename({name: f"{name}_D" for name in ("dof", "low", "high")})
    out = out.assign_coords(frequency=2 * np.pi * out["frequency"]).rename(frequency="omega_map")
    highest = min(0.9 * lines[-1], dispersion(0.7 * float(density["kx"].max()), depth, gamma) / (2 * np.pi))
    frequencies = np.arange(max(0.5, 2 * lines[1]), highest, 0.25)
    if frequencies.size:
        isotropy = directions(density, frequencies, depth, gamma=gamma)["isotropy"].values
        out = out.assign_coords(omega=2 * np.pi * frequencies).assign(isotropy=("omega", isotropy))
    return annotate(out, "direction")
