# The public names and where they live: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.calibration.target import Target as Target
from wavefield.cubes.catalog import run_catalog as run_catalog
from wavefield.cubes.forecast import check as check
from wavefield.cubes.lazy import reconstruct as reconstruct
from wavefield.cubes.running import run as run
from wavefield.cubes.workflow import Workflow as Workflow
from wavefield.grid import Grid as Grid
from wavefield.matching.gauss_newton import match as match
from wavefield.measurement.settings import Settings as Settings
from wavefield.report.write import report as report
from wavefield.rig.camera import Camera as Camera
from wavefield.rig.formats import load_rig as load_rig
from wavefield.rig.rig import Rig as Rig
from wavefield.series.experiment import Experiment as Experiment
from wavefield.store.ledger import status as status
from wavefield.store.read import open_cube as open_cube
from wavefield.tank.scene import Scene as Scene
from wavefield.tank.simulate import simulate as simulate
from wavefield.waves.analyze import analyze as analyze
from wavefield.waves.spectra import komega as komega
from wavefield.waves.spectra import spectrum as spectrum

__version__: str
