"""When the images of a camera were taken, by its own clock, and their places in the record by that."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError, FrameError
from wavefield.series.formats import open_recording
from wavefield.series.listing import Numbered
from wavefield.series.rates import recordings_of

RECORDED = "recorded"  # in place of a file of times: those in the recording
_OFF = 0.25  # of an interval: an image further from its place has none
_ROUNDED = 1e-3  # of a rate, by which clocks differ
_MOST = 10  # places for each image: what has more is several records in one file


def own_times(images: Any, camera: str, folder: Path) -> NDArray[np.float64] | None:
    """When the images in recordings were taken, where these say so.

    Returns (n,): Seconds, as they are, of one recording after the other.
    """
    parts = []
    for path in recordings_of(images, camera, folder):
        try:
            recording = open_recording(path)
        except FrameError:  # told where its images are looked for
            return None
        read = getattr(recording, "times", None)
        parts.append(np.empty(0) if read is None else read())
        recording.close()
        if not len(parts[-1]):
            return None
    times = np.concatenate(parts) if parts else np.zeros(1)
    return times if np.ptp(times) > 0 else None


def recorded_times(images: Any, camera: str, folder: Path) -> NDArray[np.float64]:
    """As `own_times`, where they are asked for.

    Returns (n,): Seconds, increasing.
    """
    if not recordings_of(images, camera, folder):
        raise ExperimentError(
            f"{camera}: `times: {RECORDED}` wants a recording, and {images} is none; name a file of times"
        )
    times = own_times(images, camera, folder)
    if times is None or np.any(np.diff(times) <= 0):
        raise ExperimentError(
            f"{images} holds no increasing times of its images: leave `times` out, or name a file of them"
        )
    return times


def read_time_stamps(path: Path, camera: str) -> np.ndarray:
    """Times of a camera's frames, one per image in order.

    Returns (n,): Times, seconds.
    """
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        raise ExperimentError(f"time stamps of {camera}: {path} cannot be read: {error.strerror}") from None
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
    numbered: Numbered, times: np.ndarray, start: float, frame_rate: float, path: Path, camera: str
) -> Numbered:
    """Renumber frames by their time stamps, so that frames dropped by the camera leave gaps.

    With times (n,), seconds; start, seconds.
    """
    if len(times) != len(numbered):
        raise ExperimentError(
            f"{path} holds {len(times)} times, but {camera} has {len(numbered)} images; every image needs one"
        )
    place = (times - start) * frame_rate
    numbers = np.rint(place).astype(int)
    worst = int(np.argmax(np.abs(place - numbers)))
    if abs(place[worst] - numbers[worst]) > _OFF or np.any(np.diff(numbers) < 1):
        raise ExperimentError(
            f"{path}: the times do not fit a frame rate of {frame_rate} Hz (image {worst} is "
            f"{abs(place[worst] - numbers[worst]):.2f} of an interval off); correct frame_rate"
        )
    return {int(number): numbered[old] for number, old in zip(numbers, sorted(numbered))}


def place_by_intervals(numbered: Numbered, times: NDArray[np.float64]) -> Numbered:
    """Renumber frames so that those the camera dropped leave gaps: by intervals, not by the clock's rate.

    With times (n,).

    Examples
    --------
    >>> place_by_intervals({0: "a", 1: "b", 2: "c", 3: "d"}, np.array([7.0, 7.1, 7.2, 7.5]))
    {0: 'a', 1: 'b', 2: 'c', 5: 'd'}
    """
    intervals = np.diff(times)
    if len(times) != len(numbered) or len(times) < 3 or intervals.min() <= 0:
        return numbered
    passed = intervals / np.median(intervals)
    whole = np.rint(passed)
    uneven = np.abs(passed - whole) > _OFF + _ROUNDED * whole
    if uneven.any() or whole.min() < 1 or whole.sum() > _MOST * len(times):
        return numbered
    old = sorted(numbered)
    places = old[0] + np.append(0, np.cumsum(whole)).astype(int)
    return {int(place): numbered[number] for place, number in zip(places, old)}
