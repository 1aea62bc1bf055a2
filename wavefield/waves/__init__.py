"""From cubes to spectra, nonlinear term and coherence: estimators with their error bars.

Input is a cube z, z_t, u, v, w (time, y, x), metres and seconds. Functions take and give labelled xarray objects;
lazy input gives lazy results, reduced in one pass over Welch segments.
"""

from wavefield.waves.record import Record, find_record, whole_record
from wavefield.waves.spectra import (
    angular_integral,
    at_frequency,
    frequency_spectrum,
    komega,
    spectrum,
    total,
)

__all__ = [
    "Record",
    "angular_integral",
    "at_frequency",
    "find_record",
    "frequency_spectrum",
    "komega",
    "spectrum",
    "total",
    "whole_record",
]
