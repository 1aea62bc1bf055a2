"""From frames to z, z_t, u, v, w with their errors, at the nodes of one grid. Arrays in, arrays out."""

from wavefield.measurement.diagnostics import Diagnosis, diagnose
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.model import LearnedRecord, Model
from wavefield.measurement.record import learn, sample_steps
from wavefield.measurement.resolution import gains
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
