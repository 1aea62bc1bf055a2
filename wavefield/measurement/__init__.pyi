# The public names and their modules: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.measurement.geometry import GridGeometry
from wavefield.measurement.model import Model
from wavefield.measurement.record import learn, sample_steps
from wavefield.measurement.settings import Settings
from wavefield.measurement.step import measure

__all__ = [
    "GridGeometry",
    "Model",
    "Settings",
    "learn",
    "measure",
    "sample_steps",
]
