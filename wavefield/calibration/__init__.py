"""From target images to a rig: finding targets, solving for the cameras, reporting how far to trust them."""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
