# The public names and where they live: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.water import dispersion, group_velocity, wavenumber
from wavefield.waves.analysis import analyze
from wavefield.waves.crests import crest_statistics
from wavefield.waves.cross import coherence, plane_coherence
from wavefield.waves.direction import directions
from wavefield.waves.dispersion_fit import fit_dispersion
from wavefield.waves.increments import structure_functions
from wavefield.waves.inputs import cube
from wavefield.waves.moments import statistics
from wavefield.waves.motion import kinematics
from wavefield.waves.phases import phase_average
from wavefield.waves.spectra import E_k, E_omega, komega, spectrum

__all__ = [
    "E_k",
    "E_omega",
    "analyze",
    "coherence",
    "crest_statistics",
    "cube",
    "directions",
    "dispersion",
    "fit_dispersion",
    "group_velocity",
    "kinematics",
    "komega",
    "phase_average",
    "plane_coherence",
    "spectrum",
    "statistics",
    "structure_functions",
    "wavenumber",
]
