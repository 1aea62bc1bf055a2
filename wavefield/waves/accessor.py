"""The xarray accessor ``cube.waves``: the wave estimators as methods of a cube."""

from collections.abc import Callable
from typing import Any

import xarray as xr

from wavefield import waves


@xr.register_dataset_accessor("waves")
class WavesAccessor:
    """Wave estimators of one cube, available as ``cube.waves``.

    Parameters
    ----------
    cube : Dataset
        z, z_t, u, v, w over (time, y, x), m and m/s, from `wavefield.open_cube` or `wavefield.cube`.

    Notes
    -----
    Every method calls the function of the same name with its keywords. Methods that analyse a single field
    take its name as their first argument.

    Examples
    --------
    >>> import wavefield as wf
    >>> wf.open_cube("sea.zarr").waves.spectrum("w").E.dims
    ('omega', 'ky', 'kx')
    """

    def __init__(self, cube: xr.Dataset) -> None:
        self._cube = cube


def _method(name: str, field: str | None) -> Callable[..., Any]:
    """Return a method of the accessor that calls the estimator `name` of `wavefield.waves`.
    The estimator receives the cube if `field` is None, otherwise the named variable, by default `field`."""

    def call_with_cube(self: WavesAccessor, *args: Any, **options: Any) -> Any:
        return getattr(waves, name)(self._cube, *args, **options)

    def call_with_field(self: WavesAccessor, field: str | None = field, **options: Any) -> Any:
        return getattr(waves, name)(self._cube[field], **options)

    method = call_with_field if field else call_with_cube
    method.__name__ = name
    method.__doc__ = f"Result of `wavefield.{name}` for {'a field of the cube' if field else 'the cube'}."
    return method


_FIELDS = {
    "spectrum": "w",
    "komega": "w",
    "structure_functions": "z",
}  # estimators of one field, with the default field
_CUBE = "fit_dispersion directions kinematics coherence statistics crest_statistics phase_average analyze"
for _name in (*_FIELDS, *_CUBE.split()):
    setattr(WavesAccessor, _name, _method(_name, _FIELDS.get(_name)))
