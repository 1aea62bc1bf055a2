"""Remarks on recordings: their frame rate, images that were dropped, clocks that drift apart."""

from collections.abc import Iterator, Mapping

import numpy as np

from wavefield.quality.frame_remarks import remark_on_absent_frames
from wavefield.quality.quality_limits import RECORD_LIMITS
from wavefield.robust import robust_std
from wavefield.series import Experiment, FrameSeries
from wavefield.series.rates import is_alike, recorded_rates, video_rates
from wavefield.store.verdict import Remark
from wavefield.text import spell_ranges

PIECES = 16  # of a record: over each the jitter of two clocks is averaged
MIN_COMMON_FRAMES = 64  # frames that two cameras share: fewer are not compared
SIGNIFICANCE = 4.0  # standard deviations of a piece's mean


def remark_on_recordings(experiment: Experiment, series: Mapping[str, FrameSeries]) -> Iterator[Remark]:
    """Report where recordings differ from the experiment file, from each other, or from an even clock."""
    measuring = {name: series[name] for name in experiment.measuring_cameras if name in series}
    yield from remark_on_absent_frames(measuring)
    yield from _ends(experiment, measuring)
    yield from _duration(experiment, series)
    yield from _rates(experiment)
    for one in series.values():
        yield from _gaps(one)
    yield from _drifts(series, experiment.frame_rate)


def _ends(experiment: Experiment, series: Mapping[str, FrameSeries]) -> Iterator[Remark]:
    """Cameras of which much is not used because others begin later or end earlier."""
    given = experiment.frames.first is not None, experiment.frames.last is not None
    for name, one in series.items():
        ends = [n for n, stated in zip(one.beyond, given) if not stated]
        if sum(ends) > max(2, RECORD_LIMITS.unused_frames * len(one)):
            yield Remark(
                name,
                "longer",
                "remark",
                f"{sum(ends)} of its frames are before or after the record, where another camera has none",
                f"{100 * RECORD_LIMITS.unused_frames:.0f} % of the record at most",
                "are the other cameras' images all there? do the frames of one moment have one number "
                "(`offset`)?",
                {"frames": sum(ends)},
            )


def _duration(experiment: Experiment, series: Mapping[str, FrameSeries]) -> Iterator[Remark]:
    """A record longer than anybody films."""
    frames = max((len(one) for one in series.values()), default=0)
    hours = frames / experiment.frame_rate / 3600.0
    if hours > RECORD_LIMITS.hours:
        yield Remark(
            "record",
            "duration",
            "remark",
            f"{frames} frames at {experiment.frame_rate:g} Hz last {hours:.3g} h",
            f"{RECORD_LIMITS.hours:.0f} h at most",
            f"is frame_rate of {experiment.path.name} in Hz, and are the frames numbered one by one?",
            {"hours": hours},
        )


def _rates(experiment: Experiment) -> Iterator[Remark]:
    named = {name: one.images for name, one in experiment.cameras.items() if one.times is None}
    for name, rate in recorded_rates(named, experiment.image_folder).items():
        if not is_alike(rate, experiment.frame_rate):
            yield Remark(
                name,
                "frame rate",
                "remark",
                f"its recording states {rate:g} Hz, {experiment.path.name} {experiment.frame_rate:g} Hz",
                "the rate of the recording",
                "leave frame_rate out to take the recording's; all is well if frames were left out since",
                values={"recorded_hz": rate, "stated_hz": experiment.frame_rate},
            )
    videos = video_rates(named, experiment.image_folder)
    alike = [name for name, rate in videos.items() if is_alike(rate, experiment.frame_rate)]
    if alike:
        yield Remark(
            alike[0],
            "playback rate",
            "note",
            f"the frame rate of {experiment.frame_rate:g} Hz is that of the playback of its video; a camera "
            "of another rate (high-speed, time lapse) needs its own as frame_rate",
            values={"playback_hz": experiment.frame_rate},
        )


def _gaps(series: FrameSeries) -> Iterator[Remark]:
    """Images that the camera dropped: gaps of its frames, or intervals that are none of whole frames."""
    if series.times is None:
        return
    there = np.flatnonzero(np.isfinite(series.times))
    places, intervals = np.diff(there), np.diff(series.times[there])
    if not len(places):
        return
    usual = float(np.median(intervals / places))
    uneven = np.abs(intervals - places * usual) > RECORD_LIMITS.uneven_interval * usual
    dropped = int((places - 1).sum())
    if dropped:
        first = int(there[np.argmax(places > 1)])
        many = "1 image was" if dropped == 1 else f"{dropped} images were"
        yield Remark(
            series.camera,
            "dropped images",
            "remark",
            f"{many} dropped, by its clock, the first after frame {series.first + first} "
            f"({series.times[first] - series.times[there[0]]:.3f} s into the record)",
            "none",
            "their places stay empty and no step is measured across them; to lose none, record to the "
            "camera's memory, to a faster disk or at a lower rate",
            {"dropped": dropped, "first": series.first + first},
        )
    if uneven.any():
        numbers = series.first + there[:-1][uneven]
        yield Remark(
            series.camera,
            "uneven times",
            "remark",
            f"{uneven.sum()} intervals between its images are no whole ones, after frame "
            f"{spell_ranges(numbers.tolist(), 3)}: velocities there are of the nominal interval, and wrong",
            "even times",
            "use an even part of the record (`frames`), or save each part as a recording of its own",
            {"uneven": int(uneven.sum()), "first": int(numbers[0])},
        )


def _drifts(series: Mapping[str, FrameSeries], rate: float) -> Iterator[Remark]:
    """Cameras whose clocks go away from that of the first."""
    timed = {name: one.times for name, one in series.items() if one.times is not None}
    if len(timed) < 2:
        return
    first = next(iter(timed))
    for name in list(timed)[1:]:
        apart = timed[name] - timed[first]
        apart = apart[np.isfinite(apart)]
        if len(apart) < MIN_COMMON_FRAMES:
            continue
        drift = float(np.ptp([np.median(piece) for piece in np.array_split(apart, PIECES)]))
        jitter = robust_std(np.diff(apart)) / np.sqrt(len(apart) / PIECES)
        if drift > max(RECORD_LIMITS.clock_drift / rate, SIGNIFICANCE * jitter):
            yield Remark(
                name,
                "drift",
                "remark",
                f"its times and those of {first} drift apart by {1e3 * drift:.3g} ms in the record, "
                f"{drift * rate:.2f} of an interval",
                f"{RECORD_LIMITS.clock_drift} of an interval at most",
                "trigger all cameras by one signal; if one triggers them, their clocks alone differ, and all "
                "is harmless where no camera is reported as delayed",
                {"drift": drift, "intervals": drift * rate},
            )
