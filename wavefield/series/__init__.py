"""Experiment files (YAML), the camera frames that they name, and the xarray engine that opens them."""

from wavefield.series.experiment import Experiment
from wavefield.series.frames import Frame, FrameSeries

__all__ = ["Experiment", "Frame", "FrameSeries"]
