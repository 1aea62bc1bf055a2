"""``cube.waves``: the estimators as methods of a cube."""

from collections.abc import Callable
from typing import Any

import xarray as xr

from wavefield import waves


@xr.register_dataset_accessor("waves")
class WavesAccessor:
    """The estimators of `wavefield` for one cube, as ``cube.waves``.

    Parameters
    ----------
    cube : Dataset
        z, z_t, u, v, w over (time, y, x), m and m/s, of `wavefield.open_cube` or `wavefield.cube`.

    Notes
    -----
    Every method takes the further keywords of the function of the same name; those of one field take its name
    first.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> axes = {"time": np.arange(128) * 0.05, "y": np.arange(24) * 0.05, "x": np.arange(32) * 0.05}
    >>> cube = xr.Dataset({"w": (tuple(axes), rng.standard_normal((128, 24, 32)))}, axes)
    >>> cube.waves.spectrum("w", segment=64).E.dims
    ('omega', 'ky', 'kx')
    """

    def __init__(self, cube: xr.Dataset) -> None:
        self._cube = cube


def _method(name: str, field: str | None) -> Callable[..., Any]:
    """The estimator of that name as a method: of a field, which comes first, or of the cube."""

    def of_cube(self: WavesAccessor, *args: Any, **options: Any) -> Any:
        return getattr(waves, name)(self._cube, *args, **options)

    def of_field(self: WavesAccessor, field: str | None = field, **options: Any) -> Any:
        return getattr(waves, name)(self._cube[field], **options)

    method = of_field if field else of_cube
    method.__name__ = name
    method.__doc__ = f"As `wavefield.{name}` of {'a field' if field else 'the cube'} returns it."
    return method


_FIELDS = {"spectrum": "w", "komega": "w", "structure_functions": "z"}  # of one field: the default
_CUBE = "fit_dispersion directions kinematics coherence statistics crest_statistics phase_average analyze"
for _name in (*_FIELDS, *_CUBE.split()):
    setattr(WavesAccessor, _name, _method(_name, _FIELDS.get(_name)))
