"""The frames of a record: numbered, numbered again by time stamps, and cut to a common range."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError
from wavefield.series.clocks import own_times, place_by_intervals, place_by_time, read_time_stamps
from wavefield.series.experiment_parts import RecordSection
from wavefield.series.frames import FrameSeries
from wavefield.series.listing import MAX_FRAMES, MAX_NUMBERS_PER_FRAME, Numbered, make_series, number_frames

Times = NDArray[np.float64]


def open_record(
    record: RecordSection, path: Path, folder: Path, measuring: Sequence[str]
) -> dict[str, FrameSeries]:
    """Return the frames of every camera, over the common range of frame numbers of the cameras `measuring`.
    The key ``frames`` of the experiment file, `path`, replaces this range. ExperimentError if images in
    `folder` are missing or cannot be numbered, or if the range has fewer than two numbers."""
    numbered = {name: number_frames(one.images, folder, name) for name, one in record.cameras.items()}
    numbered, clocks = _place_by_clocks(record, numbered, path, folder)
    for name, section in record.cameras.items():
        if section.offset:
            numbered[name] = {n + section.offset: entry for n, entry in numbered[name].items()}
    used = {name: numbered[name] for name in measuring}
    # frames before or after the common range are not reported as missing in the other cameras
    first, last = record.frames.first, record.frames.last
    first = max(min(frames) for frames in used.values()) if first is None else first
    last = min(max(frames) for frames in used.values()) if last is None else last
    if last <= first:
        ranges = ", ".join(f"{name} {min(frames)} to {max(frames)}" for name, frames in used.items())
        raise ExperimentError(
            f"{path}: the cameras share no two frames (frames of {ranges}), which a step needs; correct "
            "`offset`, or `frames` if it is given"
        )
    _refuse_sparse_numbers(path, list(used.values()), first, last)
    return make_series(numbered, first, last, clocks)


def _refuse_sparse_numbers(path: Path, numbered: Sequence[Numbered], first: int, last: int) -> None:
    """Raise ExperimentError if there are far fewer frames than frame numbers from `first` to `last`.
    Allowed are 100 numbers per frame and five million, but no negative `first` before all frames."""
    lowest = min(min(frames) for frames in numbered)
    if first < min(lowest, 0):
        raise ExperimentError(f"{path}: frames.first is {first}, but the first frame there is {lowest}")
    present = max(sum(first <= number <= last for number in frames) for frames in numbered)
    count = last - first + 1
    if count > MAX_FRAMES or count > MAX_NUMBERS_PER_FRAME * max(present, 1):
        raise ExperimentError(
            f"{path}: the record runs from frame {first} to {last}, but only {present} of these {count} "
            "numbers have a file; correct `frames`, or remove files with numbers far from the others"
        )


def _place_by_clocks(
    record: RecordSection, numbered: dict[str, Numbered], path: Path, folder: Path
) -> tuple[dict[str, Numbered], dict[str, Times]]:
    """Return the frames of each camera, with new numbers from their times, and these times (s) by camera.
    The times are those of the key ``times``, or else those in recordings. A camera without times keeps its
    frame numbers, and has no entry in the second mapping."""
    stamped: dict[str, tuple[Path, Times]] = {}
    for name, section in record.cameras.items():
        if section.times is not None:
            source = path.parent / section.times.replace("{folder}", str(folder))
            stamped[name] = source, read_time_stamps(source, name)
    if not stamped:
        times = {
            name: own_times(section.images, name, folder, record.frame_rate)
            for name, section in record.cameras.items()
        }
        clocks = {name: t for name, t in times.items() if t is not None and len(t) == len(numbered[name])}
        return numbered | {name: place_by_intervals(numbered[name], t) for name, t in clocks.items()}, clocks
    without = [name for name in numbered if name not in stamped]
    if without:
        raise ExperimentError(
            f"{path}: {without[0]} has no `times`, but other cameras have; give them all, or none"
        )
    start = min(times[0] for _, times in stamped.values())
    placed = {
        name: place_by_time(numbered[name], times, start, record.frame_rate, source, name)
        for name, (source, times) in stamped.items()
    }
    return placed, {name: times for name, (_, times) in stamped.items()}
