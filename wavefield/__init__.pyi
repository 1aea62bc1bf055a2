# The public names and where they live: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.calibration.afloat import level_experiment as level
from wavefield.calibration.images import calibrate_experiment as calibrate
from wavefield.calibration.sheet import find_sheet
from wavefield.calibration.target import Target
from wavefield.cubes.analysis import analyze_on_workers
from wavefield.cubes.catalog import run_catalog
from wavefield.cubes.forecast import check
from wavefield.cubes.gain import predicted_gain
from wavefield.cubes.lazy import reconstruct
from wavefield.cubes.running import run
from wavefield.cubes.workflow import Workflow
from wavefield.explorer.notebook import look
from wavefield.grid import Grid
from wavefield.matching.gauss_newton import match
from wavefield.measurement.settings import Settings
from wavefield.reports.paper import paper
from wavefield.reports.write import report
from wavefield.rig.camera import Camera
from wavefield.rig.formats import load_rig
from wavefield.rig.rig import Rig
from wavefield.series.experiment import Experiment
from wavefield.series.proposal import propose
from wavefield.store.export import export
from wavefield.store.ledger import status
from wavefield.store.pivpy import to_pivpy
from wavefield.store.read import open_cube
from wavefield.store.verify import verify
from wavefield.tank.scene import Scene
from wavefield.tank.simulate import simulate
from wavefield.waves.analyze import analyze
from wavefield.waves.bound import free_and_bound, free_and_bound_fields
from wavefield.waves.breaking import breaking
from wavefield.waves.budget import energy_budget
from wavefield.waves.coherence import coherence
from wavefield.waves.crests import crest_statistics
from wavefield.waves.directional import directional_spectrum
from wavefield.waves.drift import stokes_drift, surface_paths
from wavefield.waves.increments import structure_functions
from wavefield.waves.kinematics import kinematics
from wavefield.waves.resonances import resonances
from wavefield.waves.ridge import fit_dispersion
from wavefield.waves.shear import current_by_depth
from wavefield.waves.spectra import komega, spectrum
from wavefield.waves.vortices import waves_and_vortices

__version__: str

__all__ = [
    "Camera",
    "Experiment",
    "Grid",
    "Rig",
    "Scene",
    "Settings",
    "Target",
    "Workflow",
    "__version__",
    "analyze",
    "analyze_on_workers",
    "breaking",
    "calibrate",
    "check",
    "coherence",
    "crest_statistics",
    "current_by_depth",
    "directional_spectrum",
    "energy_budget",
    "export",
    "find_sheet",
    "fit_dispersion",
    "free_and_bound",
    "free_and_bound_fields",
    "kinematics",
    "komega",
    "level",
    "load_rig",
    "look",
    "match",
    "open_cube",
    "paper",
    "predicted_gain",
    "propose",
    "reconstruct",
    "report",
    "resonances",
    "run",
    "run_catalog",
    "simulate",
    "spectrum",
    "status",
    "stokes_drift",
    "structure_functions",
    "surface_paths",
    "to_pivpy",
    "verify",
    "waves_and_vortices",
]
