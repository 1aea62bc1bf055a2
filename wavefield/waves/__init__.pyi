# The public names and where they live: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.water import dispersion, group_velocity, wavenumber
from wavefield.waves.dispersion_relation.direction import directions
from wavefield.waves.dispersion_relation.dispersion_fit import fit_dispersion
from wavefield.waves.dispersion_relation.fit_settings import FitSettings
from wavefield.waves.estimation.cube_of_fields import cube
from wavefield.waves.estimation.transfer_functions import (
    elevation_from_w,
    gain_box,
    gain_displacement,
    gain_frame_mean,
    undo,
)
from wavefield.waves.estimation.wave_record import Record, find_record, whole_record
from wavefield.waves.estimation.window_gain import read_gain, window_gain
from wavefield.waves.fused.fused_spectra import fused_spectra
from wavefield.waves.nonlinear.coherence import coherence
from wavefield.waves.nonlinear.higher_order import HigherOrderSettings, higher_order
from wavefield.waves.nonlinear.kinematics import finite_residual, kinematics, kinematics_at
from wavefield.waves.nonlinear.wave_vectors import plane_coherence
from wavefield.waves.probes.probe_files import probe_spectra
from wavefield.waves.spectra.cross_spectra import cross_spectra
from wavefield.waves.spectra.field_spectra import (
    E_k,
    E_omega,
    angular_integral,
    at_frequency,
    komega,
    spectrum,
    total,
)
from wavefield.waves.surface.crests import crest_statistics
from wavefield.waves.surface.increments import structure_functions
from wavefield.waves.surface.phase_average import phase_average
from wavefield.waves.surface.statistics import statistics
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
