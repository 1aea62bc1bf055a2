"""The parts of the report, in the order of the page."""

from collections.abc import Callable

from wavefield.report.accuracy import accuracy, calibration
from wavefield.report.fields import coverage, distributions, surface
from wavefield.report.overview import recipe, setup, summary
from wavefield.report.page import Section
from wavefield.report.sources import Sources
from wavefield.report.waves import nonlinearity, spectra

SECTIONS: tuple[Callable[[Sources], Section], ...] = (
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
