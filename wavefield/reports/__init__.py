"""The report of a run: one HTML file that opens offline. `wf.report(cube)` writes it."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wavefield.reports.accuracy import errors_against
    from wavefield.reports.compose import report, write_report
    from wavefield.reports.sources import Sources, gather

# name -> where it lives; imported on first use: a page of a calibration needs nothing of the waves
_PUBLIC = {
    "Sources": "sources",
    "errors_against": "accuracy",
    "gather": "sources",
    "report": "compose",
    "write_report": "compose",
}

__all__ = ["Sources", "errors_against", "gather", "report", "write_report"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(f"wavefield.reports.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
