# The public names and their modules: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.reports.accuracy import errors_against
from wavefield.reports.compose import report

__all__ = ["errors_against", "report"]
