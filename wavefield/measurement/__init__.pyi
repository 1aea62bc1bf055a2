# The public names and their modules: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.measurement.diagnostics import Diagnosis, diagnose
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.model import LearnedRecord, Model, gains
from wavefield.measurement.record import learn, sample_steps
from wavefield.measurement.settings import Settings
from wavefield.measurement.step import measure

__all__ = [
    "Diagnosis",
    "GridGeometry",
    "LearnedRecord",
    "Model",
    "Settings",
    "diagnose",
    "gains",
    "learn",
    "measure",
    "sample_steps",
]
