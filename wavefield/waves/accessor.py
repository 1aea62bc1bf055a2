"""The xarray accessor ``cube.waves``: the estimators of `wavefield.waves` as methods of a cube."""

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
        Elevation z (m), rate of rise z_t and velocity u, v, w (m/s) over (time, y, x), from
        `wavefield.open_cube` or `wavefield.cube`. xarray passes it when ``cube.waves`` is used.

    Raises
    ------
    KeyError
        If the named field is not in the cube. Each method also raises the errors of its function.

    Notes
    -----
    Each method calls the function of `wavefield.waves` with the same name, on the cube. `spectrum`, `komega`
    and `structure_functions` work on one variable of the cube. The name of the variable is the first
    argument, by default "w" ("z" for `structure_functions`); all other arguments are keywords.

    Examples
    --------
    >>> import wavefield as wf
    >>> wf.open_cube("sea.zarr").waves.spectrum("z", segment=256).E.dims
    ('omega', 'ky', 'kx')
    """

    def __init__(self, cube: xr.Dataset) -> None:
        self._cube = cube


def _method(name: str, field: str | None) -> Callable[..., Any]:
    """Return a method for `WavesAccessor` that calls the function `name` of `wavefield.waves`. The function
    gets the cube if `field` is None, otherwise one variable of the cube, by default `field`."""

    def call_with_cube(self: WavesAccessor, *args: Any, **options: Any) -> Any:
        return getattr(waves, name)(self._cube, *args, **options)

    def call_with_field(self: WavesAccessor, field: str | None = field, **options: Any) -> Any:
        return getattr(waves, name)(self._cube[field], **options)

    method = call_with_field if field else call_with_cube
    method.__name__ = name
    method.__doc__ = f"Result of `wavefield.waves.{name}` for {'a field' if field else 'the cube'}."
    return method


_FIELDS = {
    "spectrum": "w",
    "komega": "w",
    "structure_functions": "z",
}  # estimators of one field, with the default field
_CUBE = "fit_dispersion directions kinematics coherence statistics crest_statistics phase_average analyze"
for _name in (*_FIELDS, *_CUBE.split()):
    setattr(WavesAccessor, _name, _method(_name, _FIELDS.get(_name)))
