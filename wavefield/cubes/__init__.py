"""Cubes: mapping the measurement over a series, and the store that it ends in."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wavefield.cubes.analysis import analyze_on_workers
    from wavefield.cubes.catalog import catalog_add, is_catalog, run_catalog
    from wavefield.cubes.forecast import Check, check
    from wavefield.cubes.gain import predicted_gain
    from wavefield.cubes.lazy import reconstruct
    from wavefield.cubes.running import run
    from wavefield.cubes.workflow import Workflow
    from wavefield.store.export import export
    from wavefield.store.ledger import Status, status
    from wavefield.store.read import open_cube

# public name -> where it lives; imported on first use, so that worker processes start quickly
_PUBLIC = {
    "Check": "cubes.forecast",
    "Status": "store.ledger",
    "Workflow": "cubes.workflow",
    "analyze_on_workers": "cubes.analysis",
    "catalog_add": "cubes.catalog",
    "is_catalog": "cubes.catalog",
    "run_catalog": "cubes.catalog",
    "check": "cubes.forecast",
    "export": "store.export",
    "open_cube": "store.read",
    "predicted_gain": "cubes.gain",
    "reconstruct": "cubes.lazy",
    "run": "cubes.running",
    "status": "store.ledger",
}

__all__ = [
    "Check",
    "Status",
    "Workflow",
    "analyze_on_workers",
    "catalog_add",
    "check",
    "export",
    "is_catalog",
    "open_cube",
    "predicted_gain",
    "reconstruct",
    "run",
    "run_catalog",
    "status",
]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(f"wavefield.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
