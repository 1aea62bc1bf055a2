"""Cubes: mapping the measurement over a series, and the store that it ends in."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wavefield.execution.workflow import Workflow
    from wavefield.pipeline.analysis import analyze_on_workers
    from wavefield.pipeline.catalog import catalog_add, is_catalog, run_catalog
    from wavefield.pipeline.forecast import Check, check
    from wavefield.pipeline.gain_prediction import predicted_gain
    from wavefield.pipeline.lazy import reconstruct
    from wavefield.pipeline.opened_run import Run, open_run
    from wavefield.pipeline.running import run
    from wavefield.store.export import export
    from wavefield.store.ledger import Status, status
    from wavefield.store.read import open_cube

# public name -> where it lives; imported on first use, so that worker processes start quickly
_PUBLIC = {
    "Check": "pipeline.forecast",
    "Run": "pipeline.opened_run",
    "Status": "store.ledger",
    "Workflow": "execution.workflow",
    "analyze_on_workers": "pipeline.analysis",
    "catalog_add": "pipeline.catalog",
    "is_catalog": "pipeline.catalog",
    "run_catalog": "pipeline.catalog",
    "check": "pipeline.forecast",
    "export": "store.export",
    "open_cube": "store.read",
    "open_run": "pipeline.opened_run",
    "predicted_gain": "pipeline.gain_prediction",
    "reconstruct": "pipeline.lazy",
    "run": "pipeline.running",
    "status": "store.ledger",
}

__all__ = [
    "Check",
    "Run",
    "Status",
    "Workflow",
    "analyze_on_workers",
    "catalog_add",
    "check",
    "export",
    "is_catalog",
    "open_cube",
    "open_run",
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
