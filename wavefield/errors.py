"""The exceptions that wavefield raises for mistakes that a user can correct.

Every message is one sentence that names the file or the setting at fault and how to correct it.
The command line prints it without a traceback.
"""


class WavefieldError(Exception):
    """Base class of all errors that a user can correct."""


class ExperimentError(WavefieldError):
    """An experiment, catalog or workflow file is wrong, or a file that it names."""


class FrameError(WavefieldError):
    """An image file is missing, corrupt, truncated or of an unexpected size."""


class RigError(WavefieldError):
    """A rig file cannot be read, or the rig does not fit the images or the grid."""


class CalibrationError(WavefieldError):
    """The images of the calibration target are missing, or do not give a rig that can be trusted."""


class StoreError(WavefieldError):
    """An output on disk (cube, wave store, report, export, ...) cannot be written, resumed or read."""


class RunStopped(WavefieldError):
    """A run was stopped before its end. Measured steps are kept, and the same command resumes the run."""


class CubeError(WavefieldError):
    """The data of a cube do not suit an analysis: a variable is absent, or a value or unit is wrong."""
