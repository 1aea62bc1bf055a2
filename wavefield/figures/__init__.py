"""Pictures of cubes, waves and rigs, as matplotlib figures.

Each function takes xarray datasets (a cube, one step of it, a group of a wave store) and returns a figure.
"""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
