"""The report of a run: one HTML file that opens offline. `wf.report(cube)` writes it."""

import sys
from types import ModuleType
from typing import Any

from wavefield.report.accuracy import errors_against
from wavefield.report.sources import Sources, gather
from wavefield.report.write import report, write_report

__all__ = ["Sources", "errors_against", "gather", "report", "write_report"]


class _Room(ModuleType):
    # `wavefield.report` is this room as soon as anything of it is imported, and the function before: let both
    # write a report when they are called
    def __call__(self, *args: Any, **keywords: Any) -> Any:
        return report(*args, **keywords)


sys.modules[__name__].__class__ = _Room
