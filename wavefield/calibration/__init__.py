"""From target images to a rig: finding targets, solving for the cameras, reporting how far to trust them."""

from importlib import import_module
from typing import Any

from wavefield.calibration.points import TargetPoints

# public name -> where it lives; imported on first use
_PUBLIC = {
    "Calibration": "wavefield.calibration.result",
    "Target": "wavefield.calibration.target",
    "calibrate": "wavefield.calibration.solve",
    "check_rig": "wavefield.calibration.still_water_correction",
    "find_target": "wavefield.calibration.find",
    "refine": "wavefield.calibration.still_water_correction",
    "refine_and_level": "wavefield.calibration.still_water_correction",
}

__all__ = ["TargetPoints", *sorted(_PUBLIC)]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'wavefield.calibration' has no attribute {name!r}")
