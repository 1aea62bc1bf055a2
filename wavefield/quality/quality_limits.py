"""The limits at which something about cameras, recordings or stored fields is reported."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CameraLimits:
    """Limits of the remarks on cameras."""

    covered: float = 0.08  # fraction of the patches in which a camera shows nothing
    covered_grave: float = 0.6
    blur_ratio: float = 1.6  # blur over that of the other cameras, in px and on the water
    epipolar_error: float = 0.1  # px: smallest for which correcting a rig is advised
    epipolar_error_grave: float = 0.5  # px
    agreement: float = 0.2  # fraction of the patches: two cameras that agree in fewer do not agree
    agreement_to_best: float = 0.5  # the same over the agreement of the best pair
    delay: float = 2e-5  # s: less is not noted
    delay_motion: float = 0.1  # px that a bead moves during the delay
    jump: float = 0.05  # px: a smaller one is not separated from jitter
    motion: float = 0.1  # px by which the pictures of cameras move
    jitter: float = 0.02  # px along the line of the cameras: noise gives 0.006 in poor light


@dataclass(frozen=True)
class RecordLimits:
    """Limits of the remarks on frames, recordings and stored fields."""

    bad_frames: float = 0.1  # fraction of the frames of a camera
    usable_steps: float = 0.5  # fraction of the steps
    unused_frames: float = 0.02  # fraction of a camera's frames, before and after the record
    hours: float = 24.0  # duration of a record
    uneven_interval: float = 0.5  # by which two frames may be further apart than their numbers state
    clock_drift: float = 0.1  # intervals
    discontinuity: float = 0.3  # logarithm of a step's ratio over that of its neighbours: `time_check`
    jitter: float = 1.0  # standard uncertainties by which jitter of the frame times makes values wrong
    kinematic_misfit: float = 1.6  # sound seas have 0.1 to 1.2
    kinematic_misfit_grave: float = 3.0


CAMERA_LIMITS = CameraLimits()
RECORD_LIMITS = RecordLimits()
