"""Calibrate a rig from target images: find the targets, solve for the cameras, and assess the result."""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
