"""The report of a run: one HTML file that opens offline."""

from wavefield.report.sources import Sources, gather, pixel_size
from wavefield.report.write import write_report

__all__ = ["Sources", "gather", "pixel_size", "write_report"]
