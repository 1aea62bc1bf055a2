"""Cameras' clocks: rates and times in recordings, time stamps, and frame numbers from them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError, FrameError
from wavefield.series.formats import VIDEO_ENDINGS, open_recording, recording_path
from wavefield.series.formats.arrays import SECONDS
from wavefield.series.formats.recording import usual_interval, usual_intervals
from wavefield.series.formats.video import Video
from wavefield.series.frames import FrameSeries
from wavefield.series.listing import MAX_NUMBERS_PER_FRAME, Numbered
from wavefield.series.probes import numbered_lines

Times = NDArray[np.float64]
Images = str | Sequence[str | None]

MAX_OFFSET = 0.25  # intervals between an image's time and its place: half-way to where places are ambiguous
RATE_DISAGREEMENT = 0.01  # of a rate: by as much a velocity would be wrong
UNIT_TOLERANCE = 0.05  # of a rate that the experiment file rounds
DEPARTURE_STEP = 1e-4  # intervals, to which departures are rounded: changes a velocity by as little


def own_times(images: Images, camera: str, folder: Path, frame_rate: float) -> Times | None:
    """Times of a camera's images in its recordings, (n,), s; None if there are none or they do not increase.

    A video's times are those of the playback: its usual interval counts as that of the frame rate. Other
    recordings are refused if their time stamps contradict the frame rate.
    """
    parts, paths = [], recordings_of(images, camera, folder)
    for path in paths:
        try:
            recording = open_recording(path)
        except FrameError:  # reported when the images are opened
            return None
        parts.append(recording.times())
        stated = recording.rate
        recording.close()
        if not len(parts[-1]):
            return None
    times = np.concatenate(parts) if parts else np.zeros(0)
    if len(times) < 2 or np.diff(times).min() <= 0:
        return None
    if is_video(paths[0]):
        return times / (usual_interval(times) * frame_rate) if len(paths) == 1 else None
    header = f", its header {stated:g} Hz" if stated else ""
    refuse_other_rate(times, frame_rate, f"{paths[0]}: its time stamps are at {{rate:g}} Hz{header}")
    return times


def refuse_other_rate(times: Times, frame_rate: float, words: str) -> None:
    """Refuse a frame rate that increasing time stamps, (n,), s, contradict.

    The first and last stamp of n intervals are as uncertain as one interval is, so their mean 1/n of that.
    """
    usual = usual_intervals(times)
    if not len(usual):
        return
    interval = float(usual.mean())
    frames = interval * frame_rate  # per interval
    if abs(frames - 1.0) > max(RATE_DISAGREEMENT, float(np.ptp(usual)) / interval / len(usual)):
        rate = float(f"{1.0 / interval:.4g}")
        remedy = f"set `frame_rate: {rate:g}`, or correct the times (they are in seconds)"
        for unit in ("milliseconds", "microseconds", "nanoseconds"):
            if abs(frames * SECONDS[unit] - 1.0) < UNIT_TOLERANCE:
                remedy = f"these look like {unit}; write seconds"
        raise ExperimentError(f"{words.format(rate=rate)}, but frame_rate is {frame_rate:g} Hz: {remedy}")


def read_time_stamps(path: Path, camera: str) -> Times:
    """Times of a camera's frames, (n,), s, in order: one per line, or the column `time` of a CSV file."""
    times: list[float] = []
    column, columns = 0, 1
    for number, line in numbered_lines(path, f"the time stamps of {camera}"):
        cells = [cell.strip().strip('"') for cell in line.split(",")]
        if not times and "time" in cells:
            column, columns = cells.index("time"), len(cells)
            continue
        try:
            times.append(float(cells[column] if len(cells) == columns else line))
        except ValueError:
            raise ExperimentError(
                f"{path}, line {number}: {line.strip()[:40]!r} is not one time in seconds; write one a line, "
                "or a CSV with a column `time`"
            ) from None
    out = np.array(times)
    if out.size == 0 or np.any(np.diff(out) <= 0):
        raise ExperimentError(f"the time stamps of {camera} {path} must be increasing times in seconds")
    return out


def place_by_time(
    numbered: Numbered, times: Times, start: float, frame_rate: float, path: Path, camera: str
) -> Numbered:
    """Renumber frames by their time stamps (s), so that dropped frames leave gaps."""
    if len(times) != len(numbered):
        raise ExperimentError(
            f"{path} holds {len(times)} times, but {camera} has {len(numbered)} images; every image needs one"
        )
    refuse_other_rate(times, frame_rate, f"{path}: the times of {camera} are at {{rate:g}} Hz")
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
    """Renumber frames by whole multiples of the usual interval, so that dropped frames leave gaps.

    Frames keep their numbers if their times are not near such multiples.

    Examples
    --------
    >>> place_by_intervals({0: "a", 1: "b", 2: "c", 3: "d"}, np.array([7.0, 7.1, 7.2, 7.5]))
    {0: 'a', 1: 'b', 2: 'c', 5: 'd'}
    """
    passed = np.diff(times) / usual_interval(times)
    steps = np.rint(passed)
    if np.abs(passed - steps).max() > MAX_OFFSET or steps.min() < 1:
        return numbered
    if steps.sum() > MAX_NUMBERS_PER_FRAME * len(steps):  # several records in one file
        return numbered
    old = sorted(numbered)
    places = old[0] + np.append(0, np.cumsum(steps)).astype(int)
    return {int(place): numbered[number] for place, number in zip(places, old)}


def frame_departures(series: Mapping[str, FrameSeries]) -> Times | None:
    """Delay of each frame relative to even times, (n,), in frame intervals; None if the times are even.

    The mean over the cameras' clocks, without offset and rate of each. Cameras are triggered together, so
    what their clocks do not share is noise of the stamps, by which the mean is reduced.
    """
    each = [
        found
        for one in series.values()
        if one.times is not None and (found := departures_by_clock(one.times)) is not None
    ]
    if not each:
        return None
    stack = np.stack(each)
    count = np.isfinite(stack).sum(axis=0)
    common = np.nansum(stack, axis=0) / np.maximum(count, 1)
    freedom = int(np.maximum(count - 1, 0).sum())
    power = float(np.mean(np.square(common)))
    if freedom and power:
        noise = float(np.nansum(np.square(stack - common))) / freedom / len(each)
        common *= max(power - noise, 0.0) / power
    common = np.rint(common / DEPARTURE_STEP) * DEPARTURE_STEP
    return common if common.any() else None


def departures_by_clock(times: Times) -> Times | None:
    """Delay of each frame by one clock, in intervals, from its times (n,), s; NaN for frames without a time.

    Delays are those from the regression line of time on frame number. They are 0 if none exceeds the digits
    of the stamps; None if the times are not near even intervals.

    Examples
    --------
    >>> departures_by_clock(np.array([0.0, 0.052, 0.1, 0.15, 0.2])).round(3).tolist()
    [-0.016, 0.032, -0.0, 0.008, -0.024]
    """
    there = np.flatnonzero(np.isfinite(times))
    if len(there) < 3:
        return None
    seconds = times[there]
    interval, start = np.polyfit(there, seconds - seconds[0], 1)
    late = (seconds - seconds[0] - start) / interval - there
    if np.abs(late).max() > MAX_OFFSET:
        return None
    if np.abs(late).max() * interval <= _resolution(seconds):
        late[:] = 0.0
    out = np.full(len(times), np.nan)
    out[there] = late
    return out


def _resolution(times: Times) -> float:
    """Largest power of ten, 0.1 s to 1 us, of which all times are multiples; 0 if there is none."""
    for step in 10.0 ** -np.arange(1, 7):
        if np.abs(times / step - np.rint(times / step)).max() < 1e-3:
            return float(step)
    return 0.0


class Stated(NamedTuple):
    """What a recording states of itself."""

    rate: float | None  # Hz; of a video that of its playback
    is_video: bool
    rotation: int  # degrees by which frames are to be turned for display; they are read as stored


def stated_by_recordings(cameras: Mapping[str, object], folder: Path) -> dict[str, Stated]:
    """What the first recording of each camera states; the cameras are as in the experiment file."""
    found = {}
    for name, camera in cameras.items():
        images = camera.get("images") if isinstance(camera, Mapping) else camera
        paths = recordings_of(images, str(name), folder)
        try:
            recording = open_recording(paths[0]) if paths else None
        except FrameError:  # reported when the images are opened
            continue
        if recording is not None:
            turned = recording.rotation if isinstance(recording, Video) else 0
            found[str(name)] = Stated(recording.rate, isinstance(recording, Video), turned)
            recording.close()
    return found


def is_video(path: Path) -> bool:
    """Whether a path is that of a video, whose times are those of the playback."""
    return path.suffix.lower() in VIDEO_ENDINGS


def recordings_of(images: object, camera: str, folder: Path) -> list[Path]:
    """Paths of a camera's recordings, in order; empty if any of its files is not a recording."""
    names = images if isinstance(images, list) else [images]
    paths = [folder / name.replace("{camera}", camera) for name in names if isinstance(name, str)]
    return paths if len(paths) == len(names) and all(map(recording_path, paths)) else []


def one_rate(rates: Mapping[str, float], path: Path) -> float | None:
    """The frame rate that all recordings or videos state; None without any."""
    if not rates:
        return None
    first = next(iter(rates))
    for name, rate in rates.items():
        if not is_alike(rate, rates[first]):
            raise ExperimentError(
                f"{path}: {first} was recorded at {rates[first]:g} Hz and {name} at {rate:g}: state "
                "frame_rate, and `times` for cameras that ran at another"
            )
    return rates[first]


def is_alike(one: float, other: float) -> bool:
    """Whether two rates agree as far as velocities need it.

    Examples
    --------
    >>> is_alike(500.0, 500.2), is_alike(500.0, 250.0)
    (True, False)
    """
    return abs(one - other) <= RATE_DISAGREEMENT * abs(other)
