# The public names and their modules: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.figures.crest_figures import crest_curves, flatness_curves
from wavefield.figures.distribution_figures import (
    distributions,
    error_distributions,
    error_maps,
    rest_distributions,
)
from wavefield.figures.kinematics_figures import (
    balance_history,
    coherence_curves,
    kinematics_maps,
    nonlinear_maps,
    nonlinear_ratio_curves,
    plane_coherence_maps,
    vorticity_map,
)
from wavefield.figures.nonlinear import bicoherence_map
from wavefield.figures.quality import (
    coverage_map,
    fault_history,
    misfit_distributions,
    misfit_maps,
    quality_shares,
    uncertainty_maps,
)
from wavefield.figures.rig_figures import camera_frames, method_diagram, rig_views
from wavefield.figures.spectra_figures import (
    directions,
    dispersion_ridge,
    elevation_spectra,
    komega_map,
    noise_spectra,
    probe_series,
    wavenumber_spectra,
    wavevector_map,
)
from wavefield.figures.surface_figures import elevation_map, surface_3d, velocity_map

__all__ = [
    "balance_history",
    "bicoherence_map",
    "camera_frames",
    "coherence_curves",
    "coverage_map",
    "crest_curves",
    "directions",
    "dispersion_ridge",
    "distributions",
    "elevation_map",
    "elevation_spectra",
    "error_distributions",
    "error_maps",
    "fault_history",
    "flatness_curves",
    "kinematics_maps",
    "komega_map",
    "method_diagram",
    "misfit_distributions",
    "misfit_maps",
    "noise_spectra",
    "nonlinear_maps",
    "nonlinear_ratio_curves",
    "plane_coherence_maps",
    "probe_series",
    "quality_shares",
    "rest_distributions",
    "rig_views",
    "surface_3d",
    "uncertainty_maps",
    "velocity_map",
    "vorticity_map",
    "wavenumber_spectra",
    "wavevector_map",
]
