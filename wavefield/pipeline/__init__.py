"""Cubes: mapping the measurement over a series, and the store that it ends in."""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
