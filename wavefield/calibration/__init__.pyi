# The public names and their modules: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.calibration.points import TargetPoints
from wavefield.calibration.solve import Calibration, calibrate
from wavefield.calibration.still_water import check_rig, refine_and_level
from wavefield.calibration.target import Target
from wavefield.calibration.target_images import find_target

__all__ = [
    "Calibration",
    "Target",
    "TargetPoints",
    "calibrate",
    "check_rig",
    "find_target",
    "refine_and_level",
]
