"""From cubes to spectra, nonlinear term and coherence: estimators with their error bars.

Input is a cube z, z_t, u, v, w (time, y, x), metres and seconds. Functions take and give labelled xarray
objects; lazy input gives lazy results, reduced in one pass over Welch segments.
"""

from wavefield.water import dispersion, group_velocity, wavenumber
from wavefield.waves.analyze import analyze
from wavefield.waves.bound import free_and_bound, free_and_bound_fields
from wavefield.waves.breaking import breaking
from wavefield.waves.budget import energy_budget
from wavefield.waves.coherence import coherence
from wavefield.waves.crests import crest_statistics
from wavefield.waves.crosses import cross_spectra
from wavefield.waves.direction import directions
from wavefield.waves.directional import directional_spectrum
from wavefield.waves.drift import stokes_drift, surface_paths
from wavefield.waves.fuse import fuse
from wavefield.waves.fusion import fusion
from wavefield.waves.higher_order import HigherOrderSettings, higher_order
from wavefield.waves.increments import structure_functions
from wavefield.waves.kinematics import finite_residual, kinematics, kinematics_at
from wavefield.waves.probes import probe_spectra, read_probes
from wavefield.waves.record import Record, find_record, whole_record
from wavefield.waves.resonances import ResonanceSettings, resonances
from wavefield.waves.ridge import FitSettings, fit_dispersion
from wavefield.waves.shear import ShearSettings, current_by_depth
from wavefield.waves.spectra import (
    angular_integral,
    at_frequency,
    frequency_spectrum,
    komega,
    spectrum,
    total,
)
from wavefield.waves.statistics import statistics
from wavefield.waves.transfer import (
    elevation_from_w,
    gain_box,
    gain_displacement,
    gain_four_frames,
    gain_six_frames,
    gain_two_frames,
    undo,
)
from wavefield.waves.vortices import waves_and_vortices
from wavefield.waves.wave_vectors import plane_coherence
from wavefield.waves.window_gain import read_gain, window_gain

__all__ = [
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
    "current_by_depth",
    "directional_spectrum",
    "directions",
    "dispersion",
    "elevation_from_w",
    "energy_budget",
    "find_record",
    "finite_residual",
    "fit_dispersion",
    "free_and_bound",
    "free_and_bound_fields",
    "frequency_spectrum",
    "fuse",
    "fusion",
    "gain_box",
    "gain_displacement",
    "gain_four_frames",
    "gain_six_frames",
    "gain_two_frames",
    "group_velocity",
    "higher_order",
    "kinematics",
    "kinematics_at",
    "komega",
    "plane_coherence",
    "probe_spectra",
    "read_gain",
    "read_probes",
    "resonances",
    "spectrum",
    "statistics",
    "stokes_drift",
    "structure_functions",
    "surface_paths",
    "total",
    "undo",
    "wavenumber",
    "waves_and_vortices",
    "whole_record",
    "window_gain",
]
