"""The clocks of cameras: frame rates and times in recordings, time stamps, and frame numbers from times."""

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError, FrameError
from wavefield.series.formats import VIDEO_ENDINGS, open_recording, recording_path
from wavefield.series.formats.arrays import SECONDS
from wavefield.series.formats.recordings import usual_interval, usual_intervals
from wavefield.series.frames import FrameSeries
from wavefield.series.listing import MAX_NUMBERS_PER_FRAME, Images, Numbered
from wavefield.series.probes import numbered_lines

Times = NDArray[np.float64]

MAX_OFFSET = 0.25  # largest offset of a time stamp from an even time, intervals; at 0.5 it is ambiguous
RATE_DISAGREEMENT = 0.01  # relative; velocities would be wrong by as much
UNIT_TOLERANCE = 0.05  # relative; the experiment file may give a rounded rate
DEPARTURE_STEP = 1e-4  # intervals: delays are rounded to this, which changes velocities by 0.01 %


def own_times(images: Images, camera: str, folder: Path, frame_rate: float) -> Times | None:
    """Return the times of a camera's images, (n,), s, from its recordings; None if they cannot be used.
    Usable times exist for all images and increase. Those of one video are scaled to `frame_rate`, Hz; several
    videos give None. ExperimentError if times of other recordings contradict `frame_rate`."""
    parts, paths, header = [], recordings_of(images, camera, folder), ""
    for path in paths:
        try:
            with closing(open_recording(path)) as recording:
                parts.append(recording.times())
                header = f", its header {recording.rate:g} Hz" if recording.rate else ""
        except FrameError:  # reported when the images are opened
            return None
    times = np.concatenate(parts) if parts and all(map(len, parts)) else np.zeros(0)
    if len(times) < 2 or np.diff(times).min() <= 0:
        return None
    if is_video(paths[0]):
        return times / (usual_interval(times) * frame_rate) if len(paths) == 1 else None
    refuse_other_rate(times, frame_rate, f"{paths[0]}: its time stamps are at {{rate:g}} Hz{header}")
    return times


def refuse_other_rate(times: Times, frame_rate: float, words: str) -> None:
    """Raise ExperimentError if increasing time stamps, (n,), s, contradict a frame rate, Hz.
    Their mean interval, dropped frames aside, may differ by 1 %, or by the range of the intervals divided by
    their number. `words` begin the message; ``{rate:g}`` in them becomes the rate of the time stamps, Hz."""
    usual = usual_intervals(times)
    if not len(usual):
        return
    interval = float(usual.mean())
    frames = interval * frame_rate  # frames per interval between time stamps
    if abs(frames - 1.0) > max(RATE_DISAGREEMENT, float(np.ptp(usual)) / interval / len(usual)):
        rate = float(f"{1.0 / interval:.4g}")
        remedy = f"set `frame_rate: {rate:g}`, or correct the times, which are in seconds"
        for unit in ("milliseconds", "microseconds", "nanoseconds"):
            if abs(frames * SECONDS[unit] - 1.0) < UNIT_TOLERANCE:
                remedy = f"these look like {unit}; write seconds"
        raise ExperimentError(f"{words.format(rate=rate)}, but frame_rate is {frame_rate:g} Hz: {remedy}")


def read_time_stamps(path: Path, camera: str) -> Times:
    """Read the times of a camera's images, (n,), s: one per line, or a CSV file with a column ``time``.
    ExperimentError if a line is not a number or if the times do not increase."""
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
    """Return a camera's frames with new numbers from their time stamps, so that dropped frames leave gaps.
    `times`, (n,), s, follow the order of the old numbers; a frame at the time `start`, s, gets number 0.
    ExperimentError if there is not one time per frame, or if the times do not fit `frame_rate`, Hz."""
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
    """Return a camera's frames with new numbers from the intervals between their times, (n,), s.
    The first frame keeps its number. No number changes if an interval is not near a multiple of the mean
    interval, or if there would be over 100 numbers per frame."""
    passed = np.diff(times) / usual_interval(times)
    steps = np.rint(passed)
    several_records = steps.sum() > MAX_NUMBERS_PER_FRAME * len(steps)
    if several_records or np.abs(passed - steps).max() > MAX_OFFSET or steps.min() < 1:
        return numbered
    old = sorted(numbered)
    places = old[0] + np.append(0, np.cumsum(steps)).astype(int)
    return {int(place): numbered[number] for place, number in zip(places, old)}


def frame_departures(series: Mapping[str, FrameSeries]) -> Times | None:
    """Return the delay of each frame relative to evenly spaced times, (n,), in frame intervals.
    It is the mean over the cameras' clocks. Cameras are triggered together, so clocks differ by noise; the
    mean is scaled by the fraction of its variance that is not noise. None if all delays are 0 or unknown."""
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
    """Return the delays of times, (n,), s, relative to a line fitted over frame number, in frame intervals.
    Missing times (NaN) stay NaN. All delays are 0 if none exceeds the resolution of the times. None if there
    are fewer than three times, or if a delay exceeds a quarter of a frame interval."""
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
    """Return the largest of 0.1 s, 0.01 s, ... 1 us of which all times, s, are multiples; 0 if none is."""
    for step in 10.0 ** -np.arange(1, 7):
        if np.abs(times / step - np.rint(times / step)).max() < 1e-3:
            return float(step)
    return 0.0


class Stated(NamedTuple):
    """Data in the header of a recording: frame rate, whether it is a video, and the rotation for display."""

    rate: float | None  # Frames per second (for a video, of its playback); None if not stated
    is_video: bool
    rotation: int = 0  # Rotation for display that a video states, degrees; it is not applied


def stated_by_recordings(cameras: Mapping[str, object], folder: Path) -> dict[str, Stated]:
    """Return the header data of each camera's first recording, by camera; unreadable ones are left out.
    `cameras` is the block ``cameras`` of the experiment file as plain data; paths start from `folder`."""
    found = {}
    for name, camera in cameras.items():
        images = camera.get("images") if isinstance(camera, Mapping) else camera
        paths = recordings_of(images, str(name), folder)
        try:
            if paths:
                with closing(open_recording(paths[0])) as recording:
                    found[str(name)] = Stated(recording.rate, is_video(paths[0]), recording.rotation)
        except FrameError:  # reported when the images are opened
            continue
    return found


def is_video(path: Path) -> bool:
    """Whether a path has the ending of a video file; times in a video are those of the playback."""
    return path.suffix.lower() in VIDEO_ENDINGS


def recordings_of(images: object, camera: str, folder: Path) -> list[Path]:
    """Return the paths in `folder` of a camera's recordings, from its entry `images` in the experiment file.
    The list is empty if any file in the entry does not have the ending of a recording."""
    names = images if isinstance(images, list) else [images]
    paths = [folder / name.replace("{camera}", camera) for name in names if isinstance(name, str)]
    return paths if len(paths) == len(names) and all(map(recording_path, paths)) else []


def one_rate(rates: Mapping[str, float], path: Path) -> float | None:
    """Return the frame rate, Hz, of the recordings of all cameras; None if there are no `rates`.
    ExperimentError, which names the file `path`, if a rate differs from the first by more than 1 %."""
    if not rates:
        return None
    (first, rate), *others = rates.items()
    for name, other in others:
        if not is_alike(other, rate):
            raise ExperimentError(
                f"{path}: {first} was recorded at {rate:g} Hz and {name} at {other:g}: state frame_rate, and "
                "`times` for cameras that ran at another"
            )
    return rate


def is_alike(one: float, other: float) -> bool:
    """Whether two frame rates, in the same unit, agree within 1 %."""
    return abs(one - other) <= RATE_DISAGREEMENT * abs(other)
