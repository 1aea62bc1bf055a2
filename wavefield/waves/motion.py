"""Kinematics of the surface: slopes, nonlinear term, vorticity and the balance z_t = w - u . grad z."""

from collections.abc import Mapping
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.waves import kernels
from wavefield.waves.current import delayed_current
from wavefield.waves.inputs import a_cube, takes
from wavefield.waves.products import WaveProduct, register
from wavefield.waves.record import FIELDS, check_axes, whole_record
from wavefield.waves.welch import CHANCE

Array = NDArray[Any]

OUTPUTS = ("z_x", "z_y", "nonlinear", "residual", "vorticity", "divergence")


def slopes(z: Array, dy: float, dx: float) -> tuple[Array, Array]:
    """Return the slopes z_y and z_x of z (steps, ny, nx), by central differences of sixth order."""
    z_y, z_x = np.empty_like(z), np.empty_like(z)
    kernels.gradient(z, dy, dx, z_y, z_x)
    return z_y, z_x


def terms(
    fields: Mapping[str, Array], dy: float, dx: float, current: tuple[float, float] = (0.0, 0.0)
) -> dict[str, Array]:
    """Return the quantities `OUTPUTS` by name, each (..., ny, nx), from z, z_t, u, v, w of the same shape.
    The `current`, m/s, is subtracted from u and v in the nonlinear term only."""
    shape = fields["z"].shape
    z, z_t, u, v, w = (np.ascontiguousarray(fields[name]).reshape(-1, *shape[-2:]) for name in FIELDS)
    z_y, z_x = slopes(z, dy, dx)
    u_y, u_x = slopes(u, dy, dx)
    v_y, v_x = slopes(v, dy, dx)
    # U . grad z is linear in the waves: it is part of the rate of rise in a frame that moves with the water
    nonlinear = (u - z.dtype.type(current[0])) * z_x + (v - z.dtype.type(current[1])) * z_y
    out = (z_x, z_y, nonlinear, z_t - w + u * z_x + v * z_y, v_x - u_y, u_x + v_y)
    return {name: array.reshape(shape) for name, array in zip(OUTPUTS, out)}


@takes(a_cube)
def kinematics(cube: xr.Dataset, current: tuple[float, float] | None = None) -> xr.Dataset:
    """Slopes, nonlinear term, residual, vorticity and divergence at every node.

    Parameters
    ----------
    cube : Dataset
        z (m), z_t, u, v, w (m/s) over (time, y, x), all at the same times. Lazy input gives a lazy result.
    current : tuple of float, optional
        Current U along x and y, m/s, which is subtracted from u in the nonlinear term; by default the mean of
        u and v over the record.

    Returns
    -------
    Dataset
        Over (time, y, x): slopes ``z_x``, ``z_y`` (1); ``nonlinear``, (u - U) . grad z, and ``residual``, z_t
        - w + u . grad z, m/s; ``vorticity``, v_x - u_y, and ``divergence``, u_x + v_y, of the velocity at
        the surface, 1/s. ``mean_current_x`` and ``mean_current_y``, the current U, m/s;
        ``nonlinear_ratio``, the rms of the nonlinear term over that of w.

    Raises
    ------
    CubeError
        If a variable is missing or the steps of an axis are unequal.

    Notes
    -----
    The kinematic boundary condition is z_t = w - u . grad z. U . grad z is linear in the waves: it is part of
    the rate of rise in a frame that moves with the water. Derivatives are central differences.

    Examples
    --------
    Linear waves of small slope on a current, which is subtracted.

    >>> import wavefield as wf
    >>> found = wf.kinematics(wf.open_cube("sea.zarr"))
    >>> print(f"{float(found.mean_current_x):.2f} m/s")
    0.05 m/s
    >>> bool(found.nonlinear_ratio < 0.05)
    True
    """
    for name in FIELDS:
        if name not in cube:
            raise CubeError(
                f"the cube has no {name!r}: kinematics need {', '.join(FIELDS)} over time, y and x"
            )
    cube = validate(cube, *FIELDS)
    _, dy, dx = check_axes(cube)
    fields = [cube[name].transpose("time", "y", "x") for name in FIELDS]
    lazy = any(field.chunks is not None for field in fields)
    if current is None:
        mean, _ = delayed_current(cube, whole_record(cube))
        used = da.from_delayed(mean, (2,), np.float64)
        velocity = xr.DataArray(used if lazy else used.compute(), dims="axis")
    else:
        velocity = xr.DataArray(np.asarray(current, np.float64), dims="axis")

    def compute(ux: Array, uy: Array, *arrays: Array) -> tuple[Array, ...]:
        named = dict(zip(FIELDS, arrays))
        return tuple(terms(named, dy, dx, (float(ux), float(uy))).values())

    results = xr.apply_ufunc(
        compute,
        velocity[0],
        velocity[1],
        *fields,
        input_core_dims=[[], [], *[["y", "x"]] * len(fields)],
        output_core_dims=[["y", "x"]] * len(OUTPUTS),
        dask="parallelized",
        output_dtypes=[fields[0].dtype] * len(OUTPUTS),
        dask_gufunc_kwargs={"allow_rechunk": True},
    )
    out = xr.Dataset(dict(zip(OUTPUTS, results)))
    out["mean_current_x"], out["mean_current_y"] = velocity[0], velocity[1]
    out["nonlinear_ratio"] = np.sqrt((out["nonlinear"] ** 2).mean() / (fields[-1] ** 2).mean())
    return annotate(annotate(out), "kinematics")


def kinematics_at(snapshot: xr.Dataset) -> xr.Dataset:
    """Return ``nonlinear`` and ``residual`` of `kinematics`, for zero current, at one step (y, x)."""
    fields = {name: snapshot[name].values for name in FIELDS}
    dy, dx = (float(np.mean(np.diff(snapshot[axis].values))) for axis in ("y", "x"))
    out = terms(fields, dy, dx)
    return xr.Dataset({name: snapshot.z.copy(data=out[name]) for name in ("nonlinear", "residual")})


def balance(
    fields: Mapping[str, Array], i: int, dy: float, dx: float, current: tuple[float, float] = (0.0, 0.0)
) -> dict[str, float]:
    """Return rms values over nodes at step `i`: w, z_t, nonlinear term, residual, vorticity, divergence."""
    step = {name: fields[name][i].astype(float) for name in FIELDS}
    parts = terms(step, dy, dx, current)
    values = {
        "w_rms": step["w"],
        "z_t_rms": step["z_t"],
        "nonlinear_rms": parts["nonlinear"],
        "residual_rms": parts["residual"],
        "vorticity_rms": parts["vorticity"],
        "divergence_rms": parts["divergence"],
    }
    return {name: float(np.sqrt(np.mean(np.square(v)))) for name, v in values.items()}


def balance_group(rows: list[dict[str, float]], cube: xr.Dataset) -> xr.Dataset:
    """Return a Dataset over ``step`` of the rms values in `rows`, each a result of `balance` for one step."""
    time = cube["time"].values.astype(float)
    steps = np.array([row["step"] for row in rows], int)
    names = [name for name in rows[0] if name != "step"] if rows else []
    out = xr.Dataset(
        {name: ("step", np.array([row[name] for row in rows])) for name in names},
        {"step": ("step", steps), "time": ("step", time[steps])},
    )
    mean = {name: float(np.sqrt((out[name] ** 2).mean())) for name in names}
    for fraction, part, reference in (
        ("nonlinear_fraction", "nonlinear_rms", "w_rms"),
        ("residual_fraction", "residual_rms", "nonlinear_rms"),
    ):
        out[fraction] = ((), mean[part] / mean[reference] if mean.get(reference, 0) > 0 else np.nan)
    return annotate(out, "kinematics")


def mean_current_group(mean_and_std: tuple[NDArray[np.float64], NDArray[np.float64]]) -> xr.Dataset:
    """Return a Dataset of the mean current along x and y and its standard uncertainty, m/s."""
    out, (mean, std) = {}, mean_and_std
    for i, axis in enumerate(("x", "y")):
        out[f"mean_current_{axis}"] = ((), float(mean[i]))
        out[f"mean_current_{axis}_std"] = ((), float(std[i]))
    return annotate(xr.Dataset(out), "kinematics")


def ratio_group(spectra: xr.Dataset) -> xr.Dataset:
    """Return sqrt(E_nl / E_w), for nl and w, as one curve over k and one over omega, with 95 % intervals."""
    out: dict[str, Any] = {}
    w, nl = (spectra.sel(quantity=name, drop=True) for name in ("w", "nl"))
    for axis in ("k", "omega"):
        energy, dof = f"E_{axis}", f"dof_{axis}"
        power = nl[energy] / w[energy].where(w[energy] > 0)
        dof_w, dof_nl = w[dof].values, nl[dof].values
        upper = stats.f.ppf(1 - CHANCE / 2, dof_nl, dof_w), stats.f.ppf(1 - CHANCE / 2, dof_w, dof_nl)
        name = f"nonlinear_ratio_{axis}"
        out[name] = power**0.5
        out[f"low_{name}"] = (axis, upper[0] ** -0.5)
        out[f"high_{name}"] = (axis, upper[1] ** 0.5)
    return annotate(xr.Dataset(out), "kinematics")


register(
    WaveProduct("kinematics", ("balance_rows", "cube"), balance_group, group="kinematics"),
    WaveProduct("record_current", ("mean_current",), mean_current_group, group="kinematics"),
    WaveProduct("nonlinear_ratio", ("spectra",), ratio_group, group="kinematics"),
)
