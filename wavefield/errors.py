"""The exceptions that a user can meet.

Every message is one sentence that names the file or the setting at fault and how to correct it.
The command line prints it without a traceback.
"""


class WavefieldError(Exception):
    """Base of all errors that a user can correct."""


class ExperimentError(WavefieldError):
    """The experiment file, a catalog or a workflow file, or a file that one of them names, is wrong."""


class FrameError(WavefieldError):
    """An image file is missing, corrupt, truncated or of an unexpected size."""


class RigError(WavefieldError):
    """A rig file cannot be read, or the rig does not fit the images or the grid."""


class CalibrationError(WavefieldError):
    """The images of the calibration target are missing, or do not give a rig that can be trusted."""


class StoreError(WavefieldError):
    """An output (cube, wave store, report, export, ...) cannot be written, resumed or read."""


class RunStopped(WavefieldError):
    """A run was stopped before its end; nothing is lost and the same command resumes it."""


class CubeError(WavefieldError):
    """A cube does not hold what an analysis needs."""
