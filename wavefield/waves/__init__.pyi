# The public names and where they live: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.water import dispersion, group_velocity, wavenumber
from wavefield.waves.estimation.inputs import cube
from wavefield.waves.estimation.record import Record, find_record, whole_record
from wavefield.waves.estimation.transfer_functions import (
    elevation_from_w,
    gain_box,
    gain_displacement,
    gain_frame_mean,
    undo,
)
from wavefield.waves.estimation.window_gain import read_gain, window_gain
from wavefield.waves.estimators.coherence import coherence, plane_coherence
from wavefield.waves.estimators.crests import crest_statistics
from wavefield.waves.estimators.cross_spectra import cross_spectra
from wavefield.waves.estimators.direction import directions
from wavefield.waves.estimators.dispersion_fit import fit_dispersion
from wavefield.waves.estimators.dispersion_points import FitSettings
from wavefield.waves.estimators.field_spectra import (
    E_k,
    E_omega,
    angular_integral,
    at_frequency,
    komega,
    spectrum,
    total,
)
from wavefield.waves.estimators.fused_spectra import fused_spectra
from wavefield.waves.estimators.higher_order import HigherOrderSettings, higher_order
from wavefield.waves.estimators.increments import structure_functions
from wavefield.waves.estimators.kinematics import finite_residual, kinematics, kinematics_at
from wavefield.waves.estimators.phase_average import phase_average
from wavefield.waves.estimators.probe_spectra import probe_spectra
from wavefield.waves.estimators.statistics import statistics
from wavefield.waves.wave_analysis import analyze

__all__ = [
    "E_k",
    "E_omega",
    "FitSettings",
    "HigherOrderSettings",
    "Record",
    "analyze",
    "angular_integral",
    "at_frequency",
    "coherence",
    "crest_statistics",
    "cross_spectra",
    "cube",
    "directions",
    "dispersion",
    "elevation_from_w",
    "find_record",
    "finite_residual",
    "fit_dispersion",
    "fused_spectra",
    "gain_box",
    "gain_displacement",
    "gain_frame_mean",
    "group_velocity",
    "higher_order",
    "kinematics",
    "kinematics_at",
    "komega",
    "phase_average",
    "plane_coherence",
    "probe_spectra",
    "read_gain",
    "spectrum",
    "statistics",
    "structure_functions",
    "total",
    "undo",
    "wavenumber",
    "whole_record",
    "window_gain",
]
