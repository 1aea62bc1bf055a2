"""Paths of the surface water and their drift, and the Stokes drift of a spectrum."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.water import GAMMA, dispersion
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.segments import Reader
from wavefield.waves.estimation.wave_record import Record, find_record
from wavefield.waves.estimation.welch import omega_coords
from wavefield.waves.estimation.windows import CORRELATED_CELLS
from wavefield.waves.spectra.plane_input import plane_of

Array = NDArray[Any]

STEPS_AT_A_TIME = 64
MARGIN = 2  # nodes: a spline is inaccurate nearer to the edge
# weights of the last velocities, newest first: Adams and Bashforth's, then Adams and Moulton's
_PREDICT = ((1.0,), (3 / 2, -1 / 2), (23 / 12, -16 / 12, 5 / 12), (55 / 24, -59 / 24, 37 / 24, -9 / 24))
_CORRECT = ((1 / 2, 1 / 2), (5 / 12, 8 / 12, -1 / 12), (9 / 24, 19 / 24, -5 / 24, 1 / 24))


class _Velocity:
    """Velocity (v, u) at places (2, points) between the nodes at one step, by cubic splines."""

    def __init__(self, u: Array, v: Array, step: Array) -> None:
        self.splines = [ndimage.spline_filter(part.astype(float), mode="mirror") for part in (v, u)]
        self.step = step

    def __call__(self, place: Array) -> Array:
        nodes = place / self.step[:, None]
        return np.stack(
            [ndimage.map_coordinates(s, nodes, order=3, mode="mirror", prefilter=False) for s in self.splines]
        )


def follow(velocities: Iterable[tuple[Array, Array]], place: Array, step: Array, dt: float) -> Array:
    """Places (steps, 2, points) of points of the surface that start at `place` and move with (u, v), m/s.

    Adams, Bashforth and Moulton of fourth order, corrected twice, from lower orders at the start. Points that
    leave the field are NaN.
    """
    places: list[Array] = []
    past: list[Array] = []
    for u, v in velocities:
        velocity = _Velocity(u, v, step)
        if places:
            start = places[-1]
            weights = _PREDICT[min(len(past), len(_PREDICT)) - 1]
            place = start + dt * sum(w * p for w, p in zip(weights, past))
            weights = _CORRECT[min(len(past), len(_CORRECT)) - 1]
            for _ in range(2):
                place = start + dt * sum(w * p for w, p in zip(weights, [velocity(place), *past]))
        top = (np.array(u.shape) - 1 - MARGIN) * step
        left_field = ((place < MARGIN * step[:, None]) | (place > top[:, None])).any(axis=0)
        places.append(np.where(left_field, np.nan, place))
        past = [velocity(places[-1]), *past][:4]
    return np.array(places)


@takes(a_cube)
def surface_paths(
    cube: xr.Dataset, *, duration: float = 10.0, spacing: float = 0.1, record: Record | None = None
) -> xr.Dataset:
    """Paths of points of the surface water, and how fast they drift.

    Parameters
    ----------
    cube : Dataset
        u, v over (time, y, x), m/s, at the surface. Read once, step by step; computed at once.
    duration : float
        How long points are followed before others start, s.
    spacing : float
        Distance between the points at the start, m.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``path_x``, ``path_y`` (start, path, age), m, NaN once a point has left the field; ``start_time``
        (start); ``drift_x``, ``drift_y`` of those that stayed, and ``mean_x``, ``mean_y``, the mean velocity
        at the nodes, m/s, with ``_std`` from the variance between the starts; ``stayed``, their fraction.

    Raises
    ------
    CubeError
        If u or v is missing, no run is as long as ``duration``, or no point stays in the field.

    Notes
    -----
    The mean velocity of the moving surface already holds half of the Stokes drift of deep-water waves (it is
    faster where the surface is high); paths hold all of it. Points that leave early are left out of the
    drift, which favours slow ones where few stay: compare ``stayed``. Displacements oscillate: the more
    phases the points start at, the smaller is the error of the drift.

    Examples
    --------
    Water that moves at 2 cm/s as a whole.

    >>> axes = {"time": np.arange(64) * 0.05, "y": np.arange(12) * 0.05, "x": np.arange(16) * 0.05}
    >>> still, at, units = np.zeros((64, 12, 16)), ("time", "y", "x"), {"units": "m s-1"}
    >>> cube = xr.Dataset({"u": (at, still + 0.02, units), "v": (at, still, units)}, axes)
    >>> found = surface_paths(cube, duration=1.0)
    >>> print(f"{float(found.drift_x):.3f} m/s, {float(found.stayed):.0%} stayed")
    0.020 m/s, 100% stayed
    >>> found.sizes["start"], found.sizes["age"]
    (3, 21)
    """
    fields = validate(cube, "u", "v")
    record = find_record(fields) if record is None else record
    steps = round(duration / record.dt) + 1
    starts = [(a, run) for run in record.runs for a in range(run[0], run[1] - steps + 1, steps)]
    if steps < 5 or not starts:
        raise CubeError(
            f"points cannot be followed for {duration:g} s: the longest run has {record.longest} steps of"
            f" {record.dt:g} s, and five at least are needed"
        )
    read = Reader([fields["u"], fields["v"]], record)
    step = np.array([record.dy, record.dx])
    axes = [np.arange(MARGIN * h, (n - 1 - MARGIN) * h, spacing) for n, h in zip(record.shape, step)]
    place = np.stack([part.ravel() for part in np.meshgrid(*axes, indexing="ij")])
    if not place.size:
        raise CubeError(f"no point fits into the field {spacing:g} m apart: choose a smaller spacing")
    paths, means = [], []
    for a, run in starts:
        total = np.zeros(2)
        paths.append(follow(_velocities(read, a, a + steps, run, total), place, step, record.dt))
        means.append(total / steps)
    moved = np.array([(p[-1] - p[0]) / ((steps - 1) * record.dt) for p in paths])  # (starts, 2, points)
    if not np.isfinite(moved).any():
        raise CubeError(f"no point stays in the field for {duration:g} s: choose a shorter duration")
    return _label(cube, record, np.array(paths), moved, np.array(means), [a for a, _ in starts])


def _velocities(
    read: Reader, start: int, stop: int, run: tuple[int, int], total: Array
) -> Iterator[tuple[Array, Array]]:
    """u and v of each step; their means over the nodes, (v, u), are added to `total`."""
    for first in range(start, stop, STEPS_AT_A_TIME):
        for u, v in zip(*read(first, min(first + STEPS_AT_A_TIME, stop), run)):
            total += v.mean(dtype=float), u.mean(dtype=float)
            yield u, v


def _label(
    cube: xr.Dataset, record: Record, paths: Array, moved: Array, means: Array, starts: list[int]
) -> xr.Dataset:
    origin = {"y": float(cube["y"][record.y[0]]), "x": float(cube["x"][record.x[0]])}
    stayed = np.isfinite(moved[:, 0])
    out: dict[str, Any] = {"stayed": ((), float(stayed.mean()))}
    for i, name in enumerate("yx"):
        path = origin[name] + np.moveaxis(paths[:, :, i], 1, 2)
        out[f"path_{name}"] = (("start", "path", "age"), path)
        drift, mean = moved[:, i], means[:, i]
        of_starts = np.nanmean(drift[stayed.any(axis=1)], axis=1)
        for kind, value, by_start in (
            ("drift", drift[stayed].mean(), of_starts),
            ("mean", mean.mean(), mean),
        ):
            std = by_start.std(ddof=1) / np.sqrt(by_start.size) if by_start.size > 1 else np.nan
            out[f"{kind}_{name}"], out[f"{kind}_{name}_std"] = ((), float(value)), ((), float(std))
    coords = {
        "age": ("age", np.arange(paths.shape[1]) * record.dt),
        "start_time": ("start", cube["time"].values[starts]),
    }
    return annotate(xr.Dataset(out, coords), "paths")


@takes(plane_of("z"))
def stokes_drift(
    density: xr.DataArray,
    depth: float = np.inf,
    *,
    gamma: float = GAMMA,
    current: tuple[float, float] = (0.0, 0.0),
    dof: float | None = None,
) -> xr.Dataset:
    """Stokes drift at the surface of the waves of a spectrum.

    Parameters
    ----------
    density : DataArray or Dataset
        Spectrum (omega, ky, kx) of the elevation (`spectrum`), m2 per rad/s and (rad/m)2; of a field
        (time, y, x) or of the z of a cube it is computed.
    depth : float
        Depth of the water, m; by default that of the cube, or deep.
    gamma : float
        Surface tension over density, m3/s2.
    current : tuple of float
        Velocity of the water, m/s: cells more than two of the k plane off the relation are left out.
    dof : float, optional
        Degrees of freedom of a cell, for the uncertainty.

    Returns
    -------
    Dataset
        ``stokes_x``, ``stokes_y``, m/s, and their ``_std``; ``stokes_by_omega_x``, ``stokes_by_omega_y``
        (omega), m/rad.

    Notes
    -----
    A wave of amplitude a drifts a^2 sigma k cosh(2 k h) / (2 sinh^2 k h), a^2 sigma k over deep water
    (Ursell's mean for z = 0); a^2 / 2 is the spectrum's energy. Short waves weigh heavily: energy that the
    windows take from them is missing, and noise on the relation counts.

    Examples
    --------
    A wave of 1 cm amplitude over deep water drifts a^2 sigma k.

    >>> from wavefield.waves.spectra.field_spectra import spectrum
    >>> axes = {"time": np.arange(128) * 0.05, "y": np.arange(32) * 0.05, "x": np.arange(40) * 0.05}
    >>> omega = float(dispersion(12.3))
    >>> phase = 12.3 * axes["x"] - omega * axes["time"][:, None, None] + 0 * axes["y"][:, None]
    >>> z = xr.DataArray(0.01 * np.cos(phase), axes, ("time", "y", "x"), attrs={"units": "m"})
    >>> found = stokes_drift(spectrum(z).E)
    >>> bool(abs(found.stokes_x / (0.01**2 * omega * 12.3) - 1) < 0.05)
    True
    """
    ky, kx = np.meshgrid(density["ky"].values, density["kx"].values, indexing="ij")
    omega = density["omega"].values
    k = np.hypot(ky, kx)
    kh = np.minimum(np.maximum(k, 1e-9) * min(depth, 1e300), 300.0)
    sigma = dispersion(k, depth, gamma)
    factor = np.where(k > 0, sigma * np.cosh(2 * kh) / np.sinh(kh) ** 2, 0.0)
    steps = [float(density[name][1] - density[name][0]) for name in ("omega", "ky", "kx")]
    relation = sigma + kx * current[0] + ky * current[1]
    # a Hann window spreads a wave by two lines and two cells, over which sigma changes by this
    over_two_cells = dispersion(k + 2 * max(steps[1:]), depth, gamma) - sigma
    drift, variance = np.zeros((2, omega.size)), np.zeros(2)
    for i, line in enumerate(omega[1:], 1):
        near = np.abs(line - relation) < over_two_cells + 2 * steps[0]
        energy = np.where(near, density.values[i].astype(float), 0.0) * factor * steps[1] * steps[2]
        for j, component in enumerate((kx, ky)):
            drift[j, i] = (energy * component).sum()
            variance[j] += ((energy * component) ** 2).sum()
    total = drift.sum(axis=1) * steps[0]
    correlated = CORRELATED_CELLS**3
    std = np.full(2, np.nan) if dof is None else np.sqrt(2 / dof * correlated * variance) * steps[0]
    out: dict[str, Any] = {}
    for j, name in enumerate("xy"):
        out[f"stokes_{name}"], out[f"stokes_{name}_std"] = ((), total[j]), ((), std[j])
        out[f"stokes_by_omega_{name}"] = ("omega", drift[j])
    return annotate(xr.Dataset(out, omega_coords(omega)), "drift")
