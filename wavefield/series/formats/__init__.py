"""Recordings of cameras: files that hold many images, read one image at a time."""

from collections.abc import Callable
from pathlib import Path

from wavefield.errors import FrameError
from wavefield.series.formats.arrays import open_hdf5
from wavefield.series.formats.recordings import Recording, open_cine, open_davis, open_photron, open_streampix
from wavefield.series.formats.video import Video
from wavefield.text import one_line

_OPENERS: dict[str, Callable[[Path], Recording]] = {
    ".cine": open_cine,
    ".mraw": open_photron,
    ".cih": open_photron,
    ".cihx": open_photron,
    ".seq": open_streampix,
    ".set": open_davis,
    ".h5": open_hdf5,
    ".hdf5": open_hdf5,
    ".nc": open_hdf5,
    ".avi": Video,
    ".mp4": Video,
    ".mov": Video,
    ".mkv": Video,
}
ENDINGS = tuple(_OPENERS)
VIDEO_ENDINGS = (".avi", ".mp4", ".mov", ".mkv")  # the rate in them is that of the playback

__all__ = ["ENDINGS", "VIDEO_ENDINGS", "Recording", "open_recording", "recording_path"]


def open_recording(path: str | Path) -> Recording:
    """Open a recording and read its header; of a video or DaVis set also the first image, for its size.
    `path` is a file, or file/name if the file holds several image series. FrameError if it cannot be read."""
    path = Path(path)
    file = recording_path(path)
    if file is None:
        raise FrameError(f"{path} is not a recording: its name must end in one of {', '.join(ENDINGS)}")
    try:
        there = file.is_file()
    except OSError as error:  # a name that is too long
        raise FrameError(f"{file}: {error.strerror}") from None
    if not there:
        raise FrameError(f"{file}: no such recording")
    try:
        return _OPENERS[file.suffix.lower()](path)
    except FrameError:
        raise
    except Exception as error:  # of many kinds, by the damage
        raise FrameError(
            f"{path} cannot be read as a recording ({one_line(error)}): copy it again from the camera"
        ) from None


def recording_path(path: Path) -> Path | None:
    """Return the part of a path that names a recording file, told by its ending; None if no part does.
    For ``run.h5/cam1/images`` it is ``run.h5``. The file need not exist."""
    return next((part for part in (path, *path.parents) if part.suffix.lower() in _OPENERS), None)
