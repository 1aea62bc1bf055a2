"""What estimators are given: one rule for all, applied before anything is computed.

Estimators of one field take that field, (time, y, x). Estimators of the surface take a cube. Estimators of
the dispersion relation take a spectrum E(omega, ky, kx), or a cube or a field that they make it of
(`wavefield.waves.spectra.plane_input`). Depth, surface tension and degrees of freedom that are not given are
those that the input states: a cube in its attributes, a field or a spectrum of it in its coordinates.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast

import xarray as xr

from wavefield.errors import CubeError
from wavefield.variables import CUBE_DIMS
from wavefield.water import WATER, water_coordinates, water_of

Estimator = TypeVar("Estimator", bound=Callable[..., Any])
# of what an estimator is given: what it works on, and the parameters that the input states
Convert = Callable[[Any, str], tuple[Any, dict[str, Any]]]


def takes(convert: Convert) -> Callable[[Estimator], Estimator]:
    """Convert the first argument of an estimator; parameters that are not given are read from the input."""

    def decorate(estimator: Estimator) -> Estimator:
        signature = inspect.signature(estimator)
        first = next(iter(signature.parameters))

        @functools.wraps(estimator)
        def call(*args: object, **options: object) -> Any:
            bound = signature.bind(*args, **options)
            bound.arguments[first], stated = convert(bound.arguments[first], estimator.__name__)
            for name, value in stated.items():
                if name in signature.parameters:
                    bound.arguments.setdefault(name, value)
            return estimator(*bound.args, **bound.kwargs)

        return cast(Estimator, call)

    return decorate


def described(given: object) -> str:
    """What was given, for messages."""
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


def stated_water(given: Any) -> dict[str, float]:
    """Depth and surface tension over density that a cube, a field or a spectrum states; empty if none."""
    stated = {name: given.coords[name].item() for name in WATER if name in given.coords}
    stated |= water_coordinates(given.attrs)
    if not stated:
        return {}
    depth, gamma = water_of(stated)
    return {"depth": depth, "gamma": gamma}


def keep_water(out: xr.Dataset, given: xr.DataArray) -> xr.Dataset:
    """A result with the water's coordinates of its field."""
    return out.assign_coords({name: given.coords[name] for name in WATER if name in given.coords})


def a_field(given: object, name: str) -> tuple[xr.DataArray, dict[str, Any]]:
    """A field, or a refusal."""
    if not isinstance(given, xr.DataArray):
        raise CubeError(
            f"{name} expected one variable over time, y and x (for example cube.w), got {described(given)}"
        )
    return given, stated_water(given)


def a_cube(given: Any, name: str) -> tuple[xr.Dataset, dict[str, Any]]:
    """A cube, or a refusal."""
    if not is_cube(given):
        raise CubeError(
            f"{name} needs a cube, a Dataset over time, y and x (`wavefield.cube`, `wavefield.open_cube`),"
            f" got {described(given)}"
        )
    return given, {}
