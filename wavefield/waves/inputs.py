"""Checks of the first argument of every estimator, and `cube`, which makes a cube of labelled fields.

Depth, surface tension and degrees of freedom are read from this argument (a cube, a field over (time, y, x)
or a spectrum E(omega, ky, kx)) if the caller does not give them.
"""

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import numpy as np
import xarray as xr
from scipy.interpolate import make_interp_spline

from wavefield.errors import CubeError
from wavefield.variables import CUBE_DIMS, annotate, validate
from wavefield.water import WATER, stated_water, water_of
from wavefield.waves.record import check_axes
from wavefield.waves.welch import VELOCITY, frames_of_meaning, with_stated

Estimator = TypeVar("Estimator", bound=Callable[..., Any])
# converts an argument to the object that an estimator works on, and the parameters stored in the argument
Convert = Callable[[Any, str], tuple[Any, dict[str, Any]]]


def takes(convert: Convert) -> Callable[[Estimator], Estimator]:
    """Return a decorator that checks or converts the first argument of an estimator with `convert`.
    ``convert(argument, name)`` gets the name of the estimator. It also returns a dictionary of parameters
    stored with the argument, such as the depth, which are used unless the caller gives them."""

    def decorate(estimator: Estimator) -> Estimator:
        signature = inspect.signature(estimator)
        first = next(iter(signature.parameters))

        @functools.wraps(estimator)
        def call(*args: object, **options: object) -> Any:
            bound = signature.bind(*args, **options)
            bound.arguments[first], stated = convert(with_stated(bound.arguments[first]), estimator.__name__)
            for name, value in stated.items():
                if name in signature.parameters:
                    bound.arguments.setdefault(name, value)
            return estimator(*bound.args, **bound.kwargs)

        return cast(Estimator, call)

    return decorate


def described(given: object) -> str:
    """Return a few words that describe an argument by its type and variables, for error messages."""
    if isinstance(given, xr.DataArray):
        return f"a variable over {', '.join(map(str, given.dims)) or 'nothing'}"
    if isinstance(given, xr.Dataset):
        names = [str(name) for name in given.data_vars]
        return f"a Dataset of {', '.join(names[:4]) + (', ...' if len(names) > 4 else '') or 'nothing'}"
    return f"a {type(given).__name__}"


def is_field(given: object) -> bool:
    """Return True if an argument is a DataArray over time, y and x."""
    return isinstance(given, xr.DataArray) and set(given.dims) == set(CUBE_DIMS)


def is_cube(given: object) -> bool:
    """Return True if an argument is a Dataset with the dimensions time, y and x."""
    return isinstance(given, xr.Dataset) and set(CUBE_DIMS) <= set(given.dims)


def water_parameters(given: Any) -> dict[str, float]:
    """Return "depth" (m) and "gamma" (surface tension over density, m3/s2) of `given`; {} if not stored."""
    stated = {name: given.coords[name].item() for name in WATER if name in given.coords}
    stated |= stated_water(given.attrs)
    if not stated:
        return {}
    depth, gamma = water_of(stated)
    return {"depth": depth, "gamma": gamma}


def keep_water(out: xr.Dataset, given: xr.DataArray) -> xr.Dataset:
    """Return `out` with the water depth and surface tension of `given` as coordinates, if it has them."""
    return out.assign_coords({name: given.coords[name] for name in WATER if name in given.coords})


def a_field(given: object, name: str) -> tuple[xr.DataArray, dict[str, Any]]:
    """Return `given` and its water parameters. CubeError for the estimator `name` if it is no DataArray."""
    if not isinstance(given, xr.DataArray):
        raise CubeError(
            f"{name} expected one variable over time, y and x (for example cube.w), got {described(given)}"
        )
    return given, water_parameters(given)


def a_cube(given: Any, name: str) -> tuple[xr.Dataset, dict[str, Any]]:
    """Return `given` and an empty dictionary if it is a cube, else CubeError for the estimator `name`."""
    if isinstance(given, str | Path):
        raise CubeError(f"{name} needs a cube, not its path; use wavefield.open_cube({str(given)!r})")
    if not is_cube(given):
        raise CubeError(
            f"{name} needs a cube, a Dataset over time, y and x (`wavefield.cube`, `wavefield.open_cube`),"
            f" got {described(given)}"
        )
    return given, {}


def cube(
    z: xr.DataArray,
    u: xr.DataArray | None = None,
    v: xr.DataArray | None = None,
    w: xr.DataArray | None = None,
    *,
    velocity: Literal["instantaneous", "displacement"],
    z_t: xr.DataArray | None = None,
    depth: float | None = None,
    **attrs: object,
) -> xr.Dataset:
    """Make a cube from the fields of a model or of another program, for the estimators of this package.

    Parameters
    ----------
    z : DataArray, (time, y, x)
        Elevation, m, at regular steps; ``time`` in seconds (or dates), ``x`` and ``y`` in metres. Other
        units are converted if the attribute ``units`` names them.
    u, v, w : DataArray, (time, y, x), optional
        Velocity of the water at the surface, m/s, at the same nodes and times.
    velocity : {"instantaneous", "displacement"}
        ``instantaneous`` for the velocities of a model; ``displacement`` for displacements between two
        frames, divided by the time between them.
    z_t : DataArray, (time, y, x), optional
        Rate of rise at a fixed node, m/s; by default the derivative of a spline through z. Required with
        displacements.
    depth : float, optional
        Depth of the water, m; deep water if not given.
    **attrs
        Further attributes, such as ``experiment`` or ``surface_tension_over_density``.

    Returns
    -------
    Dataset
        The fields over (time, y, x), m and m/s; ``path_frames``, the number of frames per velocity (1 for
        instantaneous velocities, 2 for displacements); attributes ``velocity``, ``frame_rate`` (Hz) and
        ``water_depth`` (m). The fields are lazy if those given are.

    Raises
    ------
    CubeError
        If the fields differ in dimensions, nodes or times, a unit or `velocity` is unknown, steps are
        unequal, or `z_t` is missing and either the velocities are displacements or z has gaps.

    Notes
    -----
    A displacement over dt contains the fraction sin(b) / b of a wave's velocity, with b = omega dt / 2. The
    elevation spectra correct this for displacements.

    Examples
    --------
    A deep-water wave of 10 mm in still water.

    >>> import numpy as np, xarray as xr, wavefield as wf
    >>> t, y, x = np.arange(100) * 0.05, np.arange(16) * 0.05, np.arange(20) * 0.05
    >>> z = 10 * np.cos(12.3 * x - 10.98 * t[:, None, None] + 0 * y[:, None])
    >>> z = xr.DataArray(z, {"time": t, "y": y, "x": x}, ("time", "y", "x"), attrs={"units": "mm"})
    >>> found = wf.cube(z, velocity="instantaneous", depth=0.7)
    >>> sorted(found.data_vars), round(float(found.z.max()), 4)
    (['z', 'z_t'], 0.01)
    """
    from wavefield.waves import accessor  # noqa: F401  # registers `cube.waves`

    given = {"z": z, "u": u, "v": v, "w": w, "z_t": z_t}
    fields = {name: _seconds(name, field) for name, field in given.items() if field is not None}
    first = fields["z"]
    for name, field in fields.items():
        check_axes(field)
        for dim in CUBE_DIMS:
            same = field.sizes[dim] == first.sizes[dim]
            if not same or not np.allclose(field[dim].values, first[dim].values, rtol=0, atol=1e-6):
                raise CubeError(f"{name!r} and 'z' differ in {dim!r}: give the same nodes and times")
    bare = {
        name: field.drop_vars([c for c in field.coords if c not in CUBE_DIMS]).assign_coords(
            {dim: first[dim] for dim in CUBE_DIMS}
        )
        for name, field in fields.items()
    }
    frames = frames_of_meaning(velocity)
    out = validate(xr.Dataset(bare), *bare)
    dt = check_axes(out)[0]
    if z_t is None:
        if velocity == "displacement":
            raise CubeError(
                "displacements go with the rise over the same step: give z_t, the difference of the"
                " elevations of two frames over the time between them"
            )
        out["z_t"] = _rate(out["z"])
    stated = {VELOCITY: velocity, "frame_rate": 1 / dt} | attrs
    if depth is not None and np.isfinite(depth):
        stated["water_depth"] = float(depth)
    coords: dict[str, Any] = {"path_frames": np.uint8(frames), **stated_water(stated)}
    return annotate(out.assign_coords(coords)).assign_attrs(stated)


def _seconds(name: str, field: object) -> xr.DataArray:
    """Return a field with times in seconds; dates become seconds since the first date."""
    if not isinstance(field, xr.DataArray):
        raise CubeError(f"{name!r} is a {type(field).__name__}: give a DataArray over time, y and x")
    if "time" in field.coords and field["time"].dtype.kind in "mM":
        since = (field["time"] - field["time"][0]).values / np.timedelta64(1, "s")
        field = field.assign_coords(time=("time", since, {"units": "s"}))
    return field


def _rate(z: xr.DataArray) -> xr.DataArray:
    """Return the time derivative of z, m/s, over (time, y, x); NaN at nodes that are never measured.
    Raises CubeError if a node is measured at some steps only."""
    t = z["time"].values.astype(float)

    def derive(values: np.ndarray) -> Any:
        flat = values.reshape(-1, t.size).T
        out = np.full(flat.shape, np.nan, values.dtype)
        there = np.isfinite(flat)
        complete = there.all(axis=0)
        if (there.any(axis=0) & ~complete).any():
            raise CubeError("z has gaps, so its time derivative is unknown there: give z_t, or fill the gaps")
        degree = min(7, (t.size - 1) | 1)  # correct to 0.3 % for waves of four steps a period
        if complete.any():
            out[:, complete] = make_interp_spline(t, flat[:, complete], degree).derivative()(t)
        return out.T.reshape(values.shape)

    whole = z if z.chunks is None else z.chunk(time=-1)
    rate: xr.DataArray = xr.apply_ufunc(
        derive,
        whole,
        input_core_dims=[["time"]],
        output_core_dims=[["time"]],
        dask="parallelized",
        output_dtypes=[z.dtype],
    )
    out: xr.DataArray = rate.transpose(*CUBE_DIMS)
    return out
