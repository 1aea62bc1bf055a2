"""Times of a camera's images by its own clock, and their places in the record by these."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError, FrameError
from wavefield.file_access import accessing
from wavefield.series.formats import open_recording
from wavefield.series.listing import Numbered
from wavefield.series.rates import recordings_of

Times = NDArray[np.float64]
Images = str | Sequence[str | None]

RECORDED = "recorded"  # in place of a file of times: those in the recording
MAX_OFFSET = 0.25  # intervals between an image's time and its place
RATE_ERROR = 1e-3  # by which the rates of clocks differ
MAX_PLACES_PER_IMAGE = 10  # more: several records in one file


def own_times(images: Images, camera: str, folder: Path) -> Times | None:
    """Times of a camera's images in its recordings, (n,), s, as they are; None where these hold none."""
    parts = []
    for path in recordings_of(images, camera, folder):
        try:
            recording = open_recording(path)
        except FrameError:  # reported when the images are opened
            return None
        parts.append(recording.times())
        recording.close()
        if not len(parts[-1]):
            return None
    times = np.concatenate(parts) if parts else np.zeros(1)
    return times if np.ptp(times) > 0 else None


def recorded_times(images: Images, camera: str, folder: Path) -> Times:
    """As `own_times`, where the experiment file requires them: increasing times."""
    if not recordings_of(images, camera, folder):
        raise ExperimentError(
            f"{camera}: `times: {RECORDED}` needs a recording, and {images} is none; name a file of times"
        )
    times = own_times(images, camera, folder)
    if times is None or np.any(np.diff(times) <= 0):
        raise ExperimentError(
            f"{images} holds no increasing times of its images: leave `times` out, or name a file of them"
        )
    return times


def read_time_stamps(path: Path, camera: str) -> Times:
    """Times of a camera's frames, (n,), s: one line per image, in order."""
    try:
        with accessing(path, ExperimentError):
            lines = path.read_text().splitlines()
    except OSError as error:
        raise ExperimentError(f"time stamps of {camera}: {path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ExperimentError(
            f"time stamps of {camera}: {path} is not a text file of one time per line, in seconds"
        ) from None
    times: list[float] = []
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            times.append(float(words[-1]))
        except ValueError:
            if times:
                raise ExperimentError(
                    f"{path}, line {number}: {words[-1]!r} is not a time in seconds"
                ) from None
    out = np.array(times)
    if out.size == 0 or np.any(np.diff(out) <= 0):
        raise ExperimentError(f"time stamps of {camera}: {path} must hold increasing times in seconds")
    return out


def place_by_time(
    numbered: Numbered, times: Times, start: float, frame_rate: float, path: Path, camera: str
) -> Numbered:
    """Renumber frames by their time stamps, s, so that frames dropped by the camera leave gaps."""
    if len(times) != len(numbered):
        raise ExperimentError(
            f"{path} holds {len(times)} times, but {camera} has {len(numbered)} images; every image needs one"
        )
    place = (times - start) * frame_rate
    numbers = np.rint(place).astype(int)
    worst = int(np.argmax(np.abs(place - numbers)))
    if abs(place[worst] - numbers[worst]) > MAX_OFFSET or np.any(np.diff(numbers) < 1):
        raise ExperimentError(
            f"{path}: the times do not fit a frame rate of {frame_rate} Hz (image {worst} is "
            f"{abs(place[worst] - numbers[worst]):.2f} of an interval off); correct frame_rate"
        )
    return {int(number): numbered[old] for number, old in zip(numbers, sorted(numbered))}


def place_by_intervals(numbered: Numbered, times: Times) -> Numbered:
    """Renumber frames so that those the camera dropped leave gaps: by intervals, not by the clock's rate.

    Examples
    --------
    >>> place_by_intervals({0: "a", 1: "b", 2: "c", 3: "d"}, np.array([7.0, 7.1, 7.2, 7.5]))
    {0: 'a', 1: 'b', 2: 'c', 5: 'd'}
    """
    intervals = np.diff(times)
    if len(times) != len(numbered) or len(times) < 3 or intervals.min() <= 0:
        return numbered
    passed = intervals / np.median(intervals)
    steps = np.rint(passed)
    uneven = np.abs(passed - steps) > MAX_OFFSET + RATE_ERROR * steps
    if uneven.any() or steps.min() < 1 or steps.sum() > MAX_PLACES_PER_IMAGE * len(times):
        return numbered
    old = sorted(numbered)
    places = old[0] + np.append(0, np.cumsum(steps)).astype(int)
    return {int(place): numbered[number] for place, number in zip(places, old)}
