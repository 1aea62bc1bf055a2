"""The report of a run: one HTML file that opens offline. `wf.report(cube)` writes it."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wavefield.reports.accuracy import errors_against
    from wavefield.reports.compose import report, write_report

# name -> its module; imported on first use: the page of a calibration needs nothing of the waves
_PUBLIC = {"errors_against": "accuracy", "report": "compose", "write_report": "compose"}

__all__ = ["errors_against", "report", "write_report"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(f"wavefield.reports.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
