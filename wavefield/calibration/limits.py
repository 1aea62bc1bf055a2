"""Limits by which a calibration accepts views of the target, and the rig that results."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CalibrationLimits:
    """What a usable calibration needs."""

    min_nodes: int = 12  # of the target in a view
    min_tilt_range: float = 10.0  # degrees between views of a camera: with less its focal length is uncertain
    max_reprojection_std: float = 0.3  # px: of a pixel of each camera, where the rig will be used
    max_z_std: float = 1e-3  # m: of z there
    max_distance_error: float = 0.05  # of a camera's distance from the origin, if it was measured by hand
    min_coverage: float = 0.4  # of an image held by views of the target: with less a note is made


LIMITS = CalibrationLimits()
