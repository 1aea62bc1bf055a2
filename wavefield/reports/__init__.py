"""The report of a run: one HTML file that opens offline. `wf.report(cube)` writes it."""

from wavefield.reports.accuracy import errors_against
from wavefield.reports.paper import paper
from wavefield.reports.sources import Sources, gather
from wavefield.reports.write import report, write_report

__all__ = ["Sources", "errors_against", "gather", "paper", "report", "write_report"]
