"""Cubes: mapping the measurement over a series, and the store that it ends in."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wavefield.cubes.catalog import catalog_add
    from wavefield.cubes.export import export_netcdf
    from wavefield.cubes.forecast import Check, check
    from wavefield.cubes.lazy import reconstruct
    from wavefield.cubes.processing import run
    from wavefield.cubes.state import Status, status
    from wavefield.cubes.store import open_cube
    from wavefield.cubes.workflow import Workflow

# public name -> where it lives; imported on first use, so that worker processes start quickly
_PUBLIC = {
    "Check": "forecast",
    "Status": "state",
    "Workflow": "workflow",
    "catalog_add": "catalog",
    "check": "forecast",
    "export_netcdf": "export",
    "open_cube": "store",
    "reconstruct": "lazy",
    "run": "processing",
    "status": "state",
}

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


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
