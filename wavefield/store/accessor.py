"""``cube.wavefield``: what a cube states beside its fields."""

from typing import Any

import xarray as xr

from wavefield.rig.camera import Camera
from wavefield.rig.rig import Rig
from wavefield.store.recipe import recipe_of
from wavefield.variables import Quality


@xr.register_dataset_accessor("wavefield")
class CubeAccessor:
    """Properties of a cube other than its fields, as ``cube.wavefield``.

    Parameters
    ----------
    cube : Dataset
        Of `open_cube`, `reconstruct` or ``xr.open_dataset("cube.zarr", engine="wavefield")``.

    Examples
    --------
    >>> import numpy as np
    >>> quality = np.full((1, 2, 2), int(Quality.MEASURED), np.uint16)
    >>> quality[0, 0, 0] = int(Quality.FILLED | Quality.MASKED)
    >>> cube = xr.Dataset({"quality": (("time", "y", "x"), quality)})
    >>> cube.wavefield.flagged("masked").values.tolist()
    [[[True, False], [False, False]]]
    """

    def __init__(self, cube: xr.Dataset) -> None:
        self._cube = cube

    def flagged(self, name: str) -> xr.DataArray:
        """Nodes whose `quality` has a flag.

        Parameters
        ----------
        name : str
            One of the ``flag_meanings`` of `quality`, such as "measured", "filled" or "masked".

        Returns
        -------
        DataArray of bool, (time, y, x)

        Raises
        ------
        ValueError
            If there is no such flag.
        """
        flags = {flag.name.lower(): flag for flag in Quality if flag.name}
        if name not in flags:
            raise ValueError(f"quality has no flag {name!r}; it has {', '.join(flags)}")
        found: xr.DataArray = (self._cube["quality"] & int(flags[name])) != 0
        return found.rename(name)

    @property
    def gain(self) -> xr.Dataset:
        """Response of the measurement to waves, (direction, k): what it keeps of their amplitude."""
        names = [f"gain_{name}" for name in "zuvw" if f"gain_{name}" in self._cube]
        return self._cube[names].reset_coords(names)

    @property
    def recipe(self) -> dict[str, Any]:
        """What the cube was made from: images, rig, grid, settings, versions; empty if it is not stated."""
        return recipe_of(self._cube.attrs)

    @property
    def rig(self) -> Rig:
        """The cameras that measured; none if the cube does not state them."""
        cameras = self.recipe.get("rig", {})
        return Rig({name: Camera.from_dict(camera) for name, camera in cameras.items()})
