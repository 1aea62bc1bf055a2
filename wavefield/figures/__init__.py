"""Pictures of cubes, waves and rigs: functions of datasets that return matplotlib figures.

Each takes plain xarray datasets (a cube, one step of it, a group of a wave store) and returns a
`matplotlib.figure.Figure`, which a notebook shows and `savefig` writes.
"""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
