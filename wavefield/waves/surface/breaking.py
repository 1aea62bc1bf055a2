"""Crests about to break: the speed of the water at a crest over the speed of the crest, B = u / c."""

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.waves.estimation.wave_record import check_axes
from wavefield.waves.nonlinear.kinematics import slopes

Array = NDArray[Any]

ONSET = 0.85  # crests that pass it break (Barthelemy et al. 2018)
_NAMES = ("z", "z_t", "u", "v")


def crest_ratio(
    z: Array,
    z_t: Array,
    u: Array,
    v: Array,
    dy: float,
    dx: float,
    reach: float,
    height: float,
    drift: tuple[float, float] = (0.0, 0.0),
) -> tuple[Array, Array]:
    """B and the crest's speed at the crests of one step.

    n is the direction of the water at the crest, seen by somebody who drifts with the mean flow, in whose
    frame both u and c are taken. The crest's speed is that of the pattern around it, z_t = -c . grad z along
    n by least squares: at the crest itself it would be a quotient of two small numbers.

    With z, z_t, u, v (ny, nx), m/s; drift, m/s; returns ratio, speed (ny, nx): B = u . n / c and c, m/s.
    """
    z_y, z_x = (part[0] for part in slopes(np.ascontiguousarray(z)[None], dy, dx))
    u, v = u - drift[0], v - drift[1]
    rise = z_t + drift[0] * z_x + drift[1] * z_y  # as the drifting observer sees it
    speed = np.hypot(u, v)
    with np.errstate(invalid="ignore", divide="ignore"):
        n_x, n_y = u / speed, v / speed
        sigma = (reach / dy, reach / dx)
        mean = [
            ndimage.gaussian_filter(part, sigma, mode="nearest", truncate=2.5)
            for part in (z_x * z_x, z_x * z_y, z_y * z_y, rise * z_x, rise * z_y)
        ]
        steep = n_x**2 * mean[0] + 2 * n_x * n_y * mean[1] + n_y**2 * mean[2]
        crest_speed = -(n_x * mean[3] + n_y * mean[4]) / steep
    ratio = speed / crest_speed
    there = _is_crest(z, n_y, n_x) & (z > height) & (crest_speed > 0)
    return np.where(there, ratio, np.nan), np.where(there, crest_speed, np.nan)


def _is_crest(z: Array, n_y: Array, n_x: Array) -> Array:
    # no lower than the surface one node ahead and behind along n
    ny, nx = z.shape
    row, column = np.meshgrid(np.arange(ny, dtype=float), np.arange(nx, dtype=float), indexing="ij")
    n_y, n_x = np.nan_to_num(n_y), np.nan_to_num(n_x)
    beside = [
        ndimage.map_coordinates(
            z, [row + sign * n_y, column + sign * n_x], order=1, mode="constant", cval=np.inf
        )
        for sign in (1, -1)
    ]
    return np.asarray((z >= beside[0]) & (z > beside[1]))


def breaking(
    cube: xr.Dataset,
    *,
    wavelength: float | None = None,
    onset: float = ONSET,
    least: float = 1.0,
) -> xr.Dataset:
    """B = u / c at every crest of a cube, and the crests that come near breaking, with their history.

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
    Barthelemy et al. 2018 (arXiv 1508.06002): crests whose B passes .85 break within a fraction of a period,
    others do not. Both speeds are relative to the mean flow of the record.

    Examples
    --------
    Waves of half a metre whose water moves at nine tenths of their own speed, 0.88 m/s, at the crests.

    >>> axes = {"time": np.arange(40) * 0.05, "y": np.arange(12) * 0.02, "x": np.arange(50) * 0.02}
    >>> phase = 4 * np.pi * axes["x"] - 11.1 * axes["time"][:, None, None] + 0 * axes["y"][:, None]
    >>> fields = {"z": 0.02 * np.cos(phase), "z_t": 0.22 * np.sin(phase), "v": 0 * phase}
    >>> fields["u"] = 0.9 * 0.88 * np.cos(phase)
    >>> units = {"z": {"units": "m"}} | {name: {"units": "m s-1"} for name in ("z_t", "u", "v")}
    >>> at = ("time", "y", "x")
    >>> cube = xr.Dataset({name: (at, field, units[name]) for name, field in fields.items()}, axes)
    >>> found = breaking(cube, wavelength=0.5)
    >>> print(f"B {float(found.B.median()):.1f}, crests at {float(found.crest_speed.median()):.2f} m/s")
    B 0.9, crests at 0.88 m/s
    >>> bool((found.event_B > 0.85).all())
    True
    """
    for name in _NAMES:
        if name not in cube:
            raise CubeError(f"the cube has no {name!r}: B at crests needs {', '.join(_NAMES)}")
    cube = validate(cube, *_NAMES)
    dt, dy, dx = check_axes(cube)
    some = cube.isel(time=np.unique(np.linspace(0, cube.sizes["time"] - 1, 32).astype(int))).compute()
    level, height = float(some["z"].mean()), float(some["z"].std())
    drift = float(some["u"].mean()), float(some["v"].mean())
    if wavelength is None:
        wavelength = _dominant(some["z"].values, dy, dx)
    ratio = np.full(tuple(cube.sizes[name] for name in ("time", "y", "x")), np.nan, np.float32)
    speed = ratio.copy()
    for t in range(ratio.shape[0]):
        now = {name: np.asarray(cube[name].isel(time=t).values, float) for name in _NAMES}
        ratio[t], speed[t] = crest_ratio(
            now["z"],
            now["z_t"],
            now["u"],
            now["v"],
            dy,
            dx,
            wavelength / 12,
            level + least * height,
            drift,
        )
    dims = ("time", "y", "x")
    coords = {name: cube[name] for name in dims}
    out = xr.Dataset({"B": (dims, ratio), "crest_speed": (dims, speed)}, coords)
    events = _events(ratio, onset, cube, dt, dy, dx)
    out = out.assign(events).assign_attrs(onset=onset, wavelength=wavelength)
    return annotate(out, "breaking")


def _dominant(z: Array, dy: float, dx: float) -> float:
    # of a wave with the same rms elevation and slope; short waves steepen: it is a lower bound
    z_y, z_x = slopes(np.ascontiguousarray(z, float), dy, dx)
    slope = float(np.sqrt(np.nanmean(z_y**2 + z_x**2)))
    return 2 * np.pi * float(np.nanstd(z)) / max(slope, 1e-12)


def _events(ratio: Array, onset: float, cube: xr.Dataset, dt: float, dy: float, dx: float) -> dict[str, Any]:
    # crests above the onset that touch in time and space are one event
    near = np.nan_to_num(ratio) >= onset
    joined = ndimage.binary_dilation(near, np.ones((3, 5, 5), bool))
    labels, count = ndimage.label(joined, np.ones((3, 3, 3), bool))
    steps, rows, columns = np.nonzero(near)
    table = pd.DataFrame(
        {
            "event": labels[near] - 1,
            "step": steps,
            "x": cube["x"].values[columns],
            "y": cube["y"].values[rows],
            "B": ratio[near],
        }
    )
    history = np.full((count, ratio.shape[0]), np.nan, np.float32)
    if count:
        by_step = table.groupby(["event", "step"])["B"].max()
        history[by_step.index.get_level_values(0), by_step.index.get_level_values(1)] = by_step.values
    groups = table.groupby("event")
    top = table.loc[groups["B"].idxmax()] if count else table
    per_step = table.groupby(["event", "step"])[["x", "y"]].agg(["min", "max"])
    length = np.hypot(
        per_step["x"]["max"] - per_step["x"]["min"] + dx, per_step["y"]["max"] - per_step["y"]["min"] + dy
    )
    return {
        "event_time": ("event", cube["time"].values[top["step"].values]),
        "event_x": ("event", top["x"].values),
        "event_y": ("event", top["y"].values),
        "event_B": ("event", top["B"].values),
        "event_duration": ("event", ((groups["step"].max() - groups["step"].min() + 1) * dt).values),
        "event_length": ("event", length.groupby("event").max().values),
        "history": (("event", "time"), history),
    }
