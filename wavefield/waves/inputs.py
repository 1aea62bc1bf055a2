"""What estimators are given: one rule for all, applied before anything is computed; cubes of fields.

Estimators of one field take that field, (time, y, x). Estimators of the surface take a cube. Estimators of
the dispersion relation take a spectrum E(omega, ky, kx), or a cube or a field of which they compute it.
Depth, surface tension and degrees of freedom that are not given are read from the input: from the attributes
of a cube, from the coordinates of a field or a spectrum.
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
# of what an estimator is given: what it works on, and the parameters that the input states
Convert = Callable[[Any, str], tuple[Any, dict[str, Any]]]


def takes(convert: Convert) -> Callable[[Estimator], Estimator]:
    """Decorator: convert the first argument of an estimator; missing parameters are read from the input."""

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
    """A short description of the input, for messages."""
    if isinstance(given, xr.DataArray):
        return f"a variable over {', '.join(map(str, given.dims)) or 'nothing'}"
    if isinstance(given, xr.Dataset):
        names = [str(name) for name in given.data_vars]
        return f"a Dataset of {', '.join(names[:4]) + (', ...' if len(names) > 4 else '') or 'nothing'}"
    return f"a {type(given).__name__}"


def is_field(given: object) -> bool:
    """Whether something is a variable over time, y and x."""
    return isinstance(given, xr.DataArray) and set(given.dims) == set(CUBE_DIMS)


def is_cube(given: object) -> bool:
    """Whether something is a Dataset with the axes of a cube."""
    return isinstance(given, xr.Dataset) and set(CUBE_DIMS) <= set(given.dims)


def water_parameters(given: Any) -> dict[str, float]:
    """Depth and surface tension over density stated by a cube, field or spectrum; empty if none."""
    stated = {name: given.coords[name].item() for name in WATER if name in given.coords}
    stated |= stated_water(given.attrs)
    if not stated:
        return {}
    depth, gamma = water_of(stated)
    return {"depth": depth, "gamma": gamma}


def keep_water(out: xr.Dataset, given: xr.DataArray) -> xr.Dataset:
    """A result with the water's coordinates of the field it came from."""
    return out.assign_coords({name: given.coords[name] for name in WATER if name in given.coords})


def a_field(given: object, name: str) -> tuple[xr.DataArray, dict[str, Any]]:
    """The input and its water parameters if it is a field; otherwise an error that says what it is.
    ``name`` is the calling function, for the message.
    """
    if not isinstance(given, xr.DataArray):
        raise CubeError(
            f"{name} expected one variable over time, y and x (for example cube.w), got {described(given)}"
        )
    return given, water_parameters(given)


def a_cube(given: Any, name: str) -> tuple[xr.Dataset, dict[str, Any]]:
    """The input if it is a cube; else raises an error that describes it."""
    if isinstance(given, str | Path):
        raise CubeError(f"{name} needs a cube, not its path; use wavefield.open_cube({str(given)!r})")
    if not is_cube(given):
        raise CubeError(
            f"{name} needs a cube, a Dataset over time, y and x (`wavefield.cube`, `wavefield.open_cube`),"
            f" got {described(given)}"
        )
    return given, {}


SPLINE_DEGREE = 7  # of the rate of rise: true to 0.3 % at four steps a period


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
    """Make a cube of labelled fields, of another program or a model, for every estimator of this package.

    Parameters
    ----------
    z : DataArray, (time, y, x)
        Elevation, m, at regular steps; ``time`` in seconds (or dates), ``x`` and ``y`` in metres. Units other
        than these are converted where the attribute ``units`` states them.
    u, v, w : DataArray, (time, y, x), optional
        Velocity of the water at the surface, m/s, at the same nodes and times.
    velocity : {"instantaneous", "displacement"}
        What the velocities are: those at an instant, as a model has them, or displacements over one step,
        centred on its middle and divided by it, as a correlation of two frames gives them.
    z_t : DataArray, (time, y, x), optional
        Rate of rise at a fixed node, m/s. By default, for instantaneous velocities, the derivative of z.
    depth : float, optional
        Depth of the water, m; deep water if not given.
    **attrs
        Further attributes, such as ``experiment`` or ``surface_tension_over_density``.

    Returns
    -------
    Dataset
        The fields with their units, ``path_frames`` (1 of instantaneous velocities, 2 of displacements), and
        the attributes ``velocity``, ``frame_rate``, Hz, and ``water_depth``, m, which is a coordinate as
        well: ``cube.w`` keeps it. Lazy where the fields are.

    Raises
    ------
    CubeError
        If a field is of other dimensions, nodes, times or units, steps are unequal, or `z_t` is missing and
        cannot be derived from z.

    Notes
    -----
    A displacement over dt holds sin(b) / b of the velocity of a wave, b = omega dt / 2, 18 % less energy at
    5 Hz in 20 frames/s, which spectra undo; nothing is undone for instantaneous velocities. The derivative of
    z is that of a spline of seventh degree through all steps.

    Examples
    --------
    A deep-water wave of 10 mm in still water.

    >>> t, y, x = np.arange(100) * 0.05, np.arange(16) * 0.05, np.arange(20) * 0.05
    >>> phase = 12.3 * x - 10.98 * t[:, None, None] + 0 * y[:, None]
    >>> axes, dims = {"time": t, "y": y, "x": x}, ("time", "y", "x")
    >>> z = xr.DataArray(10 * np.cos(phase), axes, dims, attrs={"units": "mm"})
    >>> w = xr.DataArray(0.1098 * np.sin(phase), axes, dims, attrs={"units": "m/s"})
    >>> found = cube(z, w=w, velocity="instantaneous", depth=0.7)
    >>> round(float(found.z.max()), 4), bool(abs(found.z_t - found.w).max() < 1e-2)
    (0.01, True)
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
    """A field with time in seconds; dates are counted from the first."""
    if not isinstance(field, xr.DataArray):
        raise CubeError(f"{name!r} is a {type(field).__name__}: give a DataArray over time, y and x")
    if "time" in field.coords and field["time"].dtype.kind in "mM":
        since = (field["time"] - field["time"][0]).values / np.timedelta64(1, "s")
        field = field.assign_coords(time=("time", since, {"units": "s"}))
    out: xr.DataArray = field
    return out


def _rate(z: xr.DataArray) -> xr.DataArray:
    """Derivative of z in time, m/s; NaN at nodes that are never measured."""
    t = z["time"].values.astype(float)

    def derive(values: np.ndarray) -> Any:
        flat = values.reshape(-1, t.size).T
        out = np.full(flat.shape, np.nan, values.dtype)
        there = np.isfinite(flat)
        complete = there.all(axis=0)
        if (there.any(axis=0) & ~complete).any():
            raise CubeError("z has gaps, across which its rate of rise is not known: give z_t, or fill them")
        degree = min(SPLINE_DEGREE, (t.size - 1) | 1)
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
