"""Directional spectra as oceanographers have them: E(f, theta) that wavespectra takes as its own."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import dispersion, water_of
from wavefield.waves.dispersion_relation.direction import directions
from wavefield.waves.dispersion_relation.dispersion_fit import fit_dispersion
from wavefield.waves.estimation.transfer_functions import elevation_from_w
from wavefield.waves.estimation.wave_record import Record
from wavefield.waves.estimation.welch import frames_of
from wavefield.waves.spectra.field_spectra import spectrum

Array = NDArray[Any]

SECTORS = 36
_STEP = 0.1  # Hz between the frequencies, or a line where lines lie further apart
_LOWEST = 0.5  # Hz: the integrated w holds little but drift below


def from_density(
    density: xr.DataArray,
    depth: float,
    gamma: float,
    current: tuple[float, float],
    dof: float,
    frames: int,
) -> xr.Dataset:
    """Directional spectrum of the elevation from E(ky, kx, omega) of w.

    With density (omega, ky, kx); current, m/s.
    """
    omega = density["omega"].values
    dt = np.pi / float(omega[-1])
    # the water sees omega - k . U, and w is the rise of a particle that the current carries
    still = density["omega"] - density["kx"] * current[0] - density["ky"] * current[1]
    still = abs(still.transpose(*density.dims))
    factor = elevation_from_w(still.clip(min=omega[1]), dt, frames)
    elevation = density * factor.where(still > omega[1] / 2, 0.0)
    line = float(omega[1]) / (2 * np.pi)
    shortest = dispersion(0.8 * float(density["kx"].max()), depth, gamma) / (2 * np.pi)
    step = max(_STEP, line)
    frequency = np.arange(max(_LOWEST, 3 * line), min(shortest, 0.9 * omega[-1] / (2 * np.pi)), step)
    found = directions(
        elevation,
        frequency,
        depth,
        current=current,
        sectors=SECTORS,
        dof=dof,
        gamma=gamma,
        bandwidth=step * (1 - 1e-9),
    )
    # where waves come from, clockwise from the y axis
    compass = (270 - np.degrees(found["theta"].values)) % 360
    order = np.argsort(compass)
    energy = (found["energy"] * found["D"] * np.pi / 180).values[:, order]
    out = xr.Dataset(
        {
            "efth": (("freq", "dir"), energy),
            "dof": (("freq", "dir"), found["dof"].values[:, order]),
            "mean_direction": ("freq", (270 - np.degrees(found["direction"].values)) % 360),
            "directional_spread": ("freq", np.degrees(found["spread"].values)),
            "r1": ("freq", found["r1"].values),
            "r2": ("freq", found["r2"].values),
        },
        {"freq": ("freq", frequency), "dir": ("dir", compass[order])},
        {"current_x": current[0], "current_y": current[1]},
    )
    return annotate(out, "directional")


def directional_spectrum(
    cube: xr.Dataset,
    *,
    depth: float | None = None,
    current: tuple[float, float] | None = None,
    segment: int | None = None,
    record: Record | None = None,
) -> xr.Dataset:
    """Directional spectrum of the elevation, E(f, theta).

    Parameters
    ----------
    cube : Dataset
        w over (time, y, x), m/s.
    depth : float, optional
        Depth of the water, m; the attribute ``water_depth`` of the cube, or deep, if not given.
    current : tuple of float, optional
        Velocity of the water, m/s; fitted to the ridge if not given.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``efth`` (freq, dir), m2 s degree-1; its ``dof``; ``mean_direction`` and ``directional_spread``
        (degrees), ``r1``, ``r2`` (freq). ``freq`` is in Hz as the water sees it, ``dir`` in degrees where
        waves come from, clockwise from the y axis. Computed at once.

    Raises
    ------
    CubeError
        If w is missing, the record is shorter than a segment, or no ridge can be followed and no current is
        given.

    Notes
    -----
    From w, whose ridge is the clearest, over its transfer function; waves near the ridge alone
    (`directions`). With wavespectra installed, ``import wavespectra`` gives the result ``.spec``, and
    ``to_netcdf`` writes what its readers open.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> axes = {"time": np.arange(256) * 0.05, "y": np.arange(32) * 0.05, "x": np.arange(40) * 0.05}
    >>> w = 0.01 * rng.standard_normal((256, 32, 40))
    >>> cube = xr.Dataset({"w": (("time", "y", "x"), w)}, axes, {"water_depth": 0.7})
    >>> directional_spectrum(cube, current=(0.0, 0.0), segment=64).efth.dims
    ('freq', 'dir')
    """
    fields = validate(cube, "w")
    depth, gamma = water_of(cube.attrs, depth)
    found = spectrum(fields["w"], segment=segment, record=record).compute()
    if current is None:
        try:
            fit = fit_dispersion(found["E"], depth, gamma=gamma)
        except CubeError as error:
            raise CubeError(f"{error}; or give the current") from None
        current = float(fit["current_x"]), float(fit["current_y"])
    return from_density(found["E"], depth, gamma, current, float(found["dof"]), frames_of(fields))
