"""Crests near breaking: the speed of the water at a crest over the speed of the crest, B = u / c."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.wave_record import check_axes
from wavefield.waves.nonlinear.kinematics import slopes

Array = NDArray[Any]

ONSET = 0.85  # crests that exceed it break (Barthelemy et al. 2018)
FIELDS = ("z", "z_t", "u", "v")
WAVELENGTH_OVER_SMOOTHING = 12  # the speed of a crest is estimated over a part of the wavelength
SAMPLED_STEPS = 32  # for the mean level, height and flow
EVENT_SPAN = np.ones((3, 5, 5), bool)  # steps and nodes within which crests are one event


@dataclass(frozen=True)
class CrestSettings:
    """Scales of the crests of a record."""

    distances: tuple[float, float]  # of nodes along y and x, m
    smoothing: float  # m, over which the speed of a crest is estimated
    height: float  # m: lower crests are left out
    drift: tuple[float, float] = (0.0, 0.0)  # Eulerian current along x and y, m/s


def crest_ratio(fields: Mapping[str, Array], settings: CrestSettings) -> tuple[Array, Array]:
    """B = u . n / c and the crest's speed c, m/s, at the crests of one step, (ny, nx); NaN elsewhere.
    n is the water's direction in the frame of the Eulerian current, in which u and c are.
    """
    z, z_t = fields["z"], fields["z_t"]
    drift = settings.drift
    z_y, z_x = (part[0] for part in slopes(np.ascontiguousarray(z)[None], *settings.distances))
    u, v = fields["u"] - drift[0], fields["v"] - drift[1]
    rise = z_t + drift[0] * z_x + drift[1] * z_y  # in the frame of the current
    # c is that of the pattern around a crest, z_t = -c . grad z along n by least squares: at the crest itself
    # it would be a quotient of two small numbers
    speed = np.hypot(u, v)
    with np.errstate(invalid="ignore", divide="ignore"):
        n_x, n_y = u / speed, v / speed
        sigma = [settings.smoothing / distance for distance in settings.distances]
        xx, xy, yy, tx, ty = (
            ndimage.gaussian_filter(part, sigma, mode="nearest", truncate=2.5)
            for part in (z_x * z_x, z_x * z_y, z_y * z_y, rise * z_x, rise * z_y)
        )
        slope_square = n_x**2 * xx + 2 * n_x * n_y * xy + n_y**2 * yy
        crest_speed = -(n_x * tx + n_y * ty) / slope_square
    ratio = speed / crest_speed
    crest = _is_crest(z, n_y, n_x) & (z > settings.height) & (crest_speed > 0)
    return np.where(crest, ratio, np.nan), np.where(crest, crest_speed, np.nan)


def _is_crest(z: Array, n_y: Array, n_x: Array) -> Array:
    """Whether a node is no lower than the surface one node ahead and behind along n."""
    ny, nx = z.shape
    row, column = np.meshgrid(np.arange(ny, dtype=float), np.arange(nx, dtype=float), indexing="ij")
    n_y, n_x = np.nan_to_num(n_y), np.nan_to_num(n_x)
    ahead, behind = (
        ndimage.map_coordinates(
            z, [row + sign * n_y, column + sign * n_x], order=1, mode="constant", cval=np.inf
        )
        for sign in (1, -1)
    )
    return np.asarray((z >= ahead) & (z > behind))


@takes(a_cube)
def breaking(
    cube: xr.Dataset,
    *,
    wavelength: float | None = None,
    onset: float = ONSET,
    least: float = 1.0,
) -> xr.Dataset:
    """B = u / c at every crest of a cube, and the crests near breaking, with their history.

    Parameters
    ----------
    cube : Dataset
        z, z_t, u, v over (time, y, x), m and m/s, at mid-time. Lazy input is read step by step.
    wavelength : float, optional
        Length of the dominant waves, m; from the slopes if not given.
    onset : float
        B from which a crest becomes an event.
    least : float
        Least elevation of a crest over the mean level, in standard deviations of z.

    Returns
    -------
    Dataset
        ``B``, ``crest_speed`` (time, y, x), NaN off the crests; ``event_time``, ``event_x``, ``event_y``,
        ``event_B`` (the largest), ``event_duration``, ``event_length`` (along the crest) over ``event``;
        ``history`` (event, time), the largest B of each event at each step. Computed at once.

    Raises
    ------
    CubeError
        If a variable is missing or the axes are uneven.

    Notes
    -----
    Barthelemy et al. 2018 (arXiv 1508.06002): crests whose B exceeds 0.85 break within a fraction of a
    period, others do not. Both speeds are relative to the Eulerian current <u + w grad z>: the mean of u over
    the moving surface holds half the Stokes drift besides, <w grad z> of irrotational waves, exactly.

    Examples
    --------
    Waves of half a metre whose water moves at nine tenths of their own speed, 0.88 m/s, at the crests.

    >>> axes = {"time": np.arange(40) * 0.05, "y": np.arange(12) * 0.02, "x": np.arange(50) * 0.02}
    >>> phase = 4 * np.pi * axes["x"] - 11.1 * axes["time"][:, None, None] + 0 * axes["y"][:, None]
    >>> fields = {"z": 0.02 * np.cos(phase), "z_t": 0.22 * np.sin(phase), "v": 0 * phase}
    >>> fields["u"] = 0.9 * 0.88 * np.cos(phase) + 0.028  # half the Stokes drift
    >>> units = {"z": {"units": "m"}} | {name: {"units": "m s-1"} for name in ("z_t", "u", "v")}
    >>> at = ("time", "y", "x")
    >>> cube = xr.Dataset({name: (at, field, units[name]) for name, field in fields.items()}, axes)
    >>> found = breaking(cube, wavelength=0.5)
    >>> print(f"B {float(found.B.median()):.1f}, crests at {float(found.crest_speed.median()):.1f} m/s")
    B 0.9, crests at 0.9 m/s
    >>> bool((found.event_B > 0.85).all())
    True
    """
    for name in FIELDS:
        if name not in cube:
            raise CubeError(f"the cube has no {name!r}: B at crests needs {', '.join(FIELDS)}")
    cube = validate(cube, *FIELDS)
    dt, dy, dx = check_axes(cube)
    steps = cube.sizes["time"]
    sampled = np.unique(np.linspace(0, steps - 1, SAMPLED_STEPS).astype(int))
    sample = cube.isel(time=sampled).compute()
    level, height = float(sample["z"].mean()), float(sample["z"].std())
    drift = _eulerian_current(sample, dy, dx)
    if wavelength is None:
        wavelength = _dominant_wavelength(sample["z"].values, dy, dx)
    settings = CrestSettings((dy, dx), wavelength / WAVELENGTH_OVER_SMOOTHING, level + least * height, drift)
    dims = ("time", "y", "x")
    ratio = np.full(tuple(cube.sizes[name] for name in dims), np.nan, np.float32)
    speed = ratio.copy()
    for t in range(steps):
        fields = {name: np.asarray(cube[name].isel(time=t).values, float) for name in FIELDS}
        ratio[t], speed[t] = crest_ratio(fields, settings)
    out = xr.Dataset({"B": (dims, ratio), "crest_speed": (dims, speed)}, {name: cube[name] for name in dims})
    out = out.assign(_events(out["B"], onset, dt, dy, dx)).assign_attrs(onset=onset, wavelength=wavelength)
    return annotate(out, "breaking")


def _dominant_wavelength(z: Array, dy: float, dx: float) -> float:
    """Length of a wave of the same rms elevation and slope: a lower bound, since short waves add slope."""
    z_y, z_x = slopes(np.ascontiguousarray(z, float), dy, dx)
    slope = float(np.sqrt(np.nanmean(z_y**2 + z_x**2)))
    return 2 * np.pi * float(np.nanstd(z)) / max(slope, 1e-12)


def _eulerian_current(sample: xr.Dataset, dy: float, dx: float) -> tuple[float, float]:
    """Current below the waves along x and y, m/s, of irrotational waves whose surface is (steps, ny, nx).
    With psi(x, y, t) the potential of the waves at the surface, grad psi = u - U + w grad z has no mean.
    """
    z, z_t, u, v = (np.ascontiguousarray(sample[name].values, float) for name in FIELDS)
    z_y, z_x = slopes(z, dy, dx)
    w = z_t + u * z_x + v * z_y
    return float(np.nanmean(u + w * z_x)), float(np.nanmean(v + w * z_y))


def _events(ratio: xr.DataArray, onset: float, dt: float, dy: float, dx: float) -> dict[str, Any]:
    """Variables of the events: crests above the onset that touch in time and space."""
    time, y, x = (ratio[name].values for name in ("time", "y", "x"))
    above = np.nan_to_num(ratio.values) >= onset
    joined = ndimage.binary_dilation(above, EVENT_SPAN)
    labels, count = ndimage.label(joined, np.ones((3, 3, 3), bool))
    steps, rows, columns = np.nonzero(above)
    values = {"event": labels[above] - 1, "step": steps, "x": x[columns], "y": y[rows]}
    table = pd.DataFrame(values | {"B": ratio.values[above]})
    events, by_step = table.groupby("event"), table.groupby(["event", "step"])
    history = np.full((count, time.size), np.nan, np.float32)
    largest = by_step["B"].max()
    history[largest.index.get_level_values(0), largest.index.get_level_values(1)] = largest.values
    top = table.loc[events["B"].idxmax()]
    extent = by_step[["x", "y"]].max() - by_step[["x", "y"]].min()
    length = np.hypot(extent["x"] + dx, extent["y"] + dy)
    return {
        "event_time": ("event", time[top["step"].values]),
        "event_x": ("event", top["x"].values),
        "event_y": ("event", top["y"].values),
        "event_B": ("event", top["B"].values),
        "event_duration": ("event", ((events["step"].max() - events["step"].min() + 1) * dt).values),
        "event_length": ("event", length.groupby("event").max().values),
        "history": (("event", "time"), history),
    }
