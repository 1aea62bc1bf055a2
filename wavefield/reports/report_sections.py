"""The parts of the report, in the order of the page."""

from collections.abc import Callable

from wavefield.reports.accuracy import accuracy, calibration
from wavefield.reports.field_sections import coverage, distributions, surface
from wavefield.reports.html_page import ReportSection
from wavefield.reports.overview import recipe, setup, summary
from wavefield.reports.sources import Sources
from wavefield.reports.wave_sections import nonlinearity, spectra

SECTIONS: tuple[Callable[[Sources], ReportSection], ...] = (
    summary,
    setup,
    surface,
    distributions,
    spectra,
    nonlinearity,
    accuracy,
    coverage,
    calibration,
    recipe,
)
