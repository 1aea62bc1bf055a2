# The public names and where they live: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.calibration.level_on_water import level_experiment as level
from wavefield.calibration.light_sheet import find_sheet
from wavefield.calibration.target_images import calibrate_experiment as calibrate
from wavefield.execution.workflow import Workflow
from wavefield.explorer.server import look
from wavefield.grid import Grid
from wavefield.pipeline.analysis import analyze
from wavefield.pipeline.assess import uncertainty_terms
from wavefield.pipeline.catalog import run_catalog
from wavefield.pipeline.checking import check
from wavefield.pipeline.lazy import reconstruct
from wavefield.pipeline.opened_run import open_run
from wavefield.pipeline.running import run
from wavefield.reports.compose import report
from wavefield.reports.paper import paper
from wavefield.rig.formats import load_rig
from wavefield.rig.rig import Rig
from wavefield.series.experiment import Experiment
from wavefield.series.probes import read_probes
from wavefield.series.proposal import propose
from wavefield.store.cube import open_cube
from wavefield.store.export import export
from wavefield.store.ledger import status
from wavefield.store.results import open_waves
from wavefield.store.verify import verify
from wavefield.tank.plan import plan
from wavefield.tank.scene import Scene
from wavefield.tank.write_experiment import simulate
from wavefield.waves.crests import crest_statistics
from wavefield.waves.cross import coherence
from wavefield.waves.direction import directions
from wavefield.waves.dispersion_fit import fit_dispersion
from wavefield.waves.increments import structure_functions
from wavefield.waves.inputs import cube
from wavefield.waves.moments import statistics
from wavefield.waves.motion import kinematics
from wavefield.waves.phases import phase_average
from wavefield.waves.smooth import smooth
from wavefield.waves.spectra import E_k, E_omega, komega, spectrum

__version__: str

__all__ = [
    "E_k",
    "E_omega",
    "Experiment",
    "Grid",
    "Rig",
    "Scene",
    "Workflow",
    "__version__",
    "analyze",
    "calibrate",
    "check",
    "coherence",
    "crest_statistics",
    "cube",
    "directions",
    "export",
    "find_sheet",
    "fit_dispersion",
    "kinematics",
    "komega",
    "level",
    "load_rig",
    "look",
    "open_cube",
    "open_run",
    "open_waves",
    "paper",
    "phase_average",
    "plan",
    "propose",
    "read_probes",
    "reconstruct",
    "report",
    "run",
    "run_catalog",
    "simulate",
    "smooth",
    "spectrum",
    "statistics",
    "status",
    "structure_functions",
    "uncertainty_terms",
    "verify",
]
