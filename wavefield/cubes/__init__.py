"""Cubes: mapping the measurement over a series, and the store that it ends in."""

from wavefield.cubes.catalog import catalog_add
from wavefield.cubes.check import Check, check
from wavefield.cubes.export import export_netcdf
from wavefield.cubes.lazy import reconstruct
from wavefield.cubes.run import run
from wavefield.cubes.status import Status, status
from wavefield.cubes.store import open_cube
from wavefield.cubes.workflow import Workflow

__all__ = [
    "Check",
    "Status",
    "Workflow",
    "catalog_add",
    "check",
    "export_netcdf",
    "open_cube",
    "reconstruct",
    "run",
    "status",
]
