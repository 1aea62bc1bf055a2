"""Directional spectra E(f, theta) in the convention of oceanographers, which wavespectra reads."""

import numpy as np
import xarray as xr

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import dispersion, water_of
from wavefield.waves.dispersion_relation.current_used import CurrentUsed
from wavefield.waves.dispersion_relation.direction import directions
from wavefield.waves.dispersion_relation.dispersion_fit import fit_dispersion
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.transfer_functions import elevation_from_w
from wavefield.waves.estimation.wave_record import Record
from wavefield.waves.estimation.welch import Welch, frames_of
from wavefield.waves.products import Product, register
from wavefield.waves.spectra.field_spectra import spectrum

SECTORS = 36
STEP_HZ = 0.1  # between the frequencies, or a line of the spectrum where that is more
LOWEST_HZ = 0.5  # the integrated w holds little but drift below


def from_density(
    density: xr.DataArray,
    depth: float,
    gamma: float,
    current: tuple[float, float],
    dof: float,
    frames: int,
) -> xr.Dataset:
    """Directional spectrum of the elevation from E(omega, ky, kx) of w; current in m/s."""
    omega = density["omega"].values
    dt = np.pi / float(omega[-1])
    # w is the rise of a particle that the current carries: it is integrated at omega - k . U
    intrinsic = density["omega"] - density["kx"] * current[0] - density["ky"] * current[1]
    intrinsic = abs(intrinsic.transpose(*density.dims))
    factor = elevation_from_w(intrinsic.clip(min=omega[1]), dt, frames)
    elevation = density * factor.where(intrinsic > omega[1] / 2, 0.0)
    line = float(omega[1]) / (2 * np.pi)
    shortest = dispersion(0.8 * float(density["kx"].max()), depth, gamma) / (2 * np.pi)
    step = max(STEP_HZ, line)
    frequency = np.arange(max(LOWEST_HZ, 3 * line), min(shortest, 0.9 * omega[-1] / (2 * np.pi)), step)
    by_direction = directions(
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
    compass = (270 - np.degrees(by_direction["theta"].values)) % 360
    order = np.argsort(compass)
    energy = (by_direction["energy"] * by_direction["D"] * np.pi / 180).values[:, order]
    out = xr.Dataset(
        {
            "efth": (("freq", "dir"), energy),
            "dof": (("freq", "dir"), by_direction["dof"].values[:, order]),
            "mean_direction": ("freq", (270 - np.degrees(by_direction["direction"].values)) % 360),
            "directional_spread": ("freq", np.degrees(by_direction["spread"].values)),
            "r1": ("freq", by_direction["r1"].values),
            "r2": ("freq", by_direction["r2"].values),
        },
        {"freq": ("freq", frequency), "dir": ("dir", compass[order])},
        {"current_x": current[0], "current_y": current[1]},
    )
    return annotate(out, "directional")


@takes(a_cube)
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
        Velocity of the water, m/s; fitted to the dispersion relation if not given.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``efth`` (freq, dir), m2 s degree-1; its ``dof``; ``mean_direction`` and ``directional_spread``
        (degrees), ``r1``, ``r2`` (freq). ``freq`` is in Hz in the frame of the water, ``dir`` in
        degrees, where waves come from, clockwise from the y axis. Computed at once.

    Raises
    ------
    CubeError
        If w is missing, the record is shorter than a segment, or the fit is refused and no current is given.

    Notes
    -----
    From w, which shows the dispersion relation most clearly, over its transfer function; of waves near the
    relation alone (`directions`). With wavespectra installed, ``import wavespectra`` gives the result
    ``.spec``, and ``to_netcdf`` writes what its readers open.

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
    of_w = spectrum(fields["w"], segment=segment, record=record).compute()
    if current is None:
        try:
            fit = fit_dispersion(of_w["E"], depth, gamma=gamma)
        except CubeError as error:
            raise CubeError(f"{error}; or give the current") from None
        current = float(fit["current_x"]), float(fit["current_y"])
    return from_density(of_w["E"], depth, gamma, current, of_w.attrs["degrees_of_freedom"], frames_of(fields))


def _group(density: xr.DataArray, depth: float, gamma: float, used: CurrentUsed, welch: Welch) -> xr.Dataset:
    return from_density(density, depth, gamma, used.velocity, welch.dof, welch.frames).assign_attrs(
        used.attrs
    )


register(
    Product(
        "directional",
        ("density_w", "depth", "gamma", "fitted_or_given_current", "welch"),
        _group,
        group="directional",
        without="No directional spectrum",
        cost=3,
    )
)
