# The public names and where they live: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.water import dispersion, group_velocity, wavenumber
from wavefield.waves.dispersion_relation.current_by_depth import ShearSettings, current_by_depth
from wavefield.waves.dispersion_relation.direction import directions
from wavefield.waves.dispersion_relation.directional_spectrum import directional_spectrum
from wavefield.waves.dispersion_relation.dispersion_fit import fit_dispersion
from wavefield.waves.dispersion_relation.fit_settings import FitSettings
from wavefield.waves.dispersion_relation.ridge_broadening import ridge_broadening
from wavefield.waves.dispersion_relation.wavelet_directions import wavelet_directions
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
from wavefield.waves.fused.fused_series import fused_series
from wavefield.waves.fused.fused_spectra import fused_spectra
from wavefield.waves.nonlinear.bound_waves import free_and_bound, free_and_bound_fields
from wavefield.waves.nonlinear.coherence import coherence
from wavefield.waves.nonlinear.higher_order import HigherOrderSettings, higher_order
from wavefield.waves.nonlinear.kinematics import finite_residual, kinematics, kinematics_at
from wavefield.waves.nonlinear.linear_surface import linear_surface
from wavefield.waves.nonlinear.nonlinear_ratio import nonlinear_ratio
from wavefield.waves.nonlinear.resonances import ResonanceSettings, resonances
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
from wavefield.waves.spectra.spectral_slope import spectral_slope
from wavefield.waves.surface.breaking import breaking
from wavefield.waves.surface.crests import crest_statistics
from wavefield.waves.surface.drift import stokes_drift, surface_paths
from wavefield.waves.surface.energy_budget import energy_budget
from wavefield.waves.surface.energy_flux import energy_flux
from wavefield.waves.surface.increments import structure_functions
from wavefield.waves.surface.phase_average import phase_average
from wavefield.waves.surface.statistics import statistics
from wavefield.waves.surface.subsurface import subsurface
from wavefield.waves.surface.vortices import waves_and_vortices
from wavefield.waves.wave_analysis import analyze

__all__ = [
    "E_k",
    "E_omega",
    "FitSettings",
    "HigherOrderSettings",
    "Record",
    "ResonanceSettings",
    "ShearSettings",
    "analyze",
    "angular_integral",
    "at_frequency",
    "breaking",
    "coherence",
    "crest_statistics",
    "cross_spectra",
    "cube",
    "current_by_depth",
    "directional_spectrum",
    "directions",
    "dispersion",
    "elevation_from_w",
    "energy_budget",
    "energy_flux",
    "find_record",
    "finite_residual",
    "fit_dispersion",
    "free_and_bound",
    "free_and_bound_fields",
    "fused_series",
    "fused_spectra",
    "gain_box",
    "gain_displacement",
    "gain_frame_mean",
    "group_velocity",
    "higher_order",
    "kinematics",
    "kinematics_at",
    "komega",
    "linear_surface",
    "nonlinear_ratio",
    "phase_average",
    "plane_coherence",
    "probe_spectra",
    "read_gain",
    "resonances",
    "ridge_broadening",
    "spectral_slope",
    "spectrum",
    "statistics",
    "stokes_drift",
    "structure_functions",
    "subsurface",
    "surface_paths",
    "total",
    "undo",
    "wavelet_directions",
    "wavenumber",
    "waves_and_vortices",
    "whole_record",
    "window_gain",
]
