"""Cameras and rigs: geometry only, no images."""

from wavefield.rig.camera import Camera
from wavefield.rig.rig import Rig

__all__ = ["Camera", "Rig"]
