"""``cube.waves``: the estimators as methods of a cube."""

from typing import Any

import xarray as xr


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

    def spectrum(self, field: str = "w", **options: Any) -> xr.Dataset:
        """E(omega, ky, kx) of a field, as `wavefield.spectrum` returns it."""
        from wavefield.waves import spectrum

        return spectrum(self._cube[field], **options)

    def komega(self, field: str = "w", **options: Any) -> xr.Dataset:
        """E(omega, k) of a field, as `wavefield.komega` returns it."""
        from wavefield.waves import komega

        return komega(self._cube[field], **options)

    def structure_functions(self, field: str = "z", **options: Any) -> xr.Dataset:
        """Moments of the increments of a field, as `wavefield.structure_functions` returns them."""
        from wavefield.waves import structure_functions

        return structure_functions(self._cube[field], **options)

    def fit_dispersion(self, **options: Any) -> xr.Dataset:
        """Current and surface tension, as `wavefield.fit_dispersion` returns them."""
        from wavefield.waves import fit_dispersion

        cube: Any = self._cube
        return fit_dispersion(cube, **options)

    def directions(self, frequency: Any = None, **options: Any) -> xr.Dataset:
        """Directional spectrum, as `wavefield.directions` returns it."""
        from wavefield.waves import directions

        return directions(self._cube, frequency, **options)

    def kinematics(self, **options: Any) -> xr.Dataset:
        """Slopes, nonlinear term and residual, as `wavefield.kinematics` returns them."""
        from wavefield.waves import kinematics

        return kinematics(self._cube, **options)

    def coherence(self, **options: Any) -> xr.Dataset:
        """Coherence of z_t with w and the nonlinear term, as `wavefield.coherence` returns it."""
        from wavefield.waves import coherence

        return coherence(self._cube, **options)

    def statistics(self, **options: Any) -> xr.Dataset:
        """Moments and densities, as `wavefield.statistics` returns them."""
        from wavefield.waves import statistics

        return statistics(self._cube, **options)

    def crest_statistics(self, **options: Any) -> xr.Dataset:
        """Crests and troughs, as `wavefield.crest_statistics` returns them."""
        from wavefield.waves import crest_statistics

        return crest_statistics(self._cube, **options)

    def phase_average(self, *args: Any, **options: Any) -> xr.Dataset:
        """Average over the phase of a periodic wave, as `wavefield.phase_average` returns it."""
        from wavefield.waves import phase_average

        return phase_average(self._cube, *args, **options)

    def analyze(self, **options: Any) -> xr.DataTree:
        """All products of an analysis, as `wavefield.analyze` returns them."""
        from wavefield.waves import analyze

        return analyze(self._cube, **options)
