"""The report of a run: one HTML file that opens offline."""

from wavefield.report.sections import errors_against
from wavefield.report.sources import Sources, gather
from wavefield.report.write import write_report

__all__ = ["Sources", "errors_against", "gather", "write_report"]
