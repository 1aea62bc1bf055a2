# The public names and their modules: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.figures.kinematics import (
    coherence_curves,
    kinematics_maps,
    nonlinear_ratio_curves,
    plane_coherence_maps,
)
from wavefield.figures.measurement import (
    coverage_map,
    distributions,
    error_distributions,
    fault_history,
    misfit_maps,
    rest_distributions,
    uncertainty_maps,
)
from wavefield.figures.rig import camera_frames, rig_views
from wavefield.figures.surface import surface_3d, velocity_map
from wavefield.figures.waves import (
    bicoherence_map,
    crest_curves,
    directions,
    dispersion_ridge,
    elevation_spectra,
    flatness_curves,
    komega_map,
    probe_series,
    wavenumber_spectra,
    wavevector_map,
)

__all__ = [
    "bicoherence_map",
    "camera_frames",
    "coherence_curves",
    "coverage_map",
    "crest_curves",
    "directions",
    "dispersion_ridge",
    "distributions",
    "elevation_spectra",
    "error_distributions",
    "fault_history",
    "flatness_curves",
    "kinematics_maps",
    "komega_map",
    "misfit_maps",
    "nonlinear_ratio_curves",
    "plane_coherence_maps",
    "probe_series",
    "rest_distributions",
    "rig_views",
    "surface_3d",
    "uncertainty_maps",
    "velocity_map",
    "wavenumber_spectra",
    "wavevector_map",
]
