"""Cubes: mapping the measurement over a series, and the store that it ends in."""

from wavefield.cubes.lazy import reconstruct
from wavefield.cubes.run import run
from wavefield.cubes.status import status
from wavefield.cubes.store import open_cube
from wavefield.cubes.workflow import Workflow

__all__ = ["Workflow", "open_cube", "reconstruct", "run", "status"]
