"""Turn images into a cube and its waves: learn the noise, measure all steps, assess them, analyse waves."""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
