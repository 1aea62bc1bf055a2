"""The geometry of cameras and rigs: projection, sight lines, and the field that all cameras see."""

from wavefield.rig.camera import Camera
from wavefield.rig.field import common_field
from wavefield.rig.rig import Rig

__all__ = ["Camera", "Rig", "common_field"]
