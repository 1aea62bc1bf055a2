"""The reading rate that the workers of a run need, and the rate that the disk of the images gives."""

import os
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from wavefield.series import FrameSeries

_SAMPLE_BYTES, _SAMPLE_SECONDS = 200_000_000, 1.0  # read to measure the disk: whichever comes first
_LEAST_BYTES = 1_000_000  # less is too little to measure a disk
_PIECE = 4_000_000  # bytes of one read


@dataclass(frozen=True)
class ReadingSpeed:
    """The reading rate that a run needs and the rate that its disk gives."""

    step_bytes: float  # Bytes of images that a step takes from the disk
    worker_rate: float  # What one worker needs, bytes/s
    workers: int  # How many there are
    # What one reader gets from the images' disk, bytes/s; None where too little could be read
    disk_rate: float | None = None

    @property
    def enough_for(self) -> int | None:
        """Workers that one reader's rate supplies; None where it was not measured."""
        return None if self.disk_rate is None else max(int(self.disk_rate / self.worker_rate), 1)

    @property
    def limited(self) -> bool:
        """Whether the workers need more than one reader gets."""
        return self.disk_rate is not None and self.workers * self.worker_rate > self.disk_rate

    def __str__(self) -> str:
        text = f"reading: each worker reads {_rate(self.worker_rate)}"
        if self.workers > 1:
            text += f", {self.workers} workers {_rate(self.workers * self.worker_rate)}"
        if self.disk_rate is None:
            return text
        text += f"; one reader gets {_rate(self.disk_rate)} from the disk of the images"
        if not self.limited:
            return text
        few = "1 worker" if self.enough_for == 1 else f"{self.enough_for} workers"
        return (
            f"{text}: beyond {few} the disk is the limit, unless several readers get more; read from "
            "a local or parallel file system, or write smaller images"
        )


def _rate(value: float) -> str:
    return f"{value / 1e9:.1f} GB/s" if value >= 1e9 else f"{value / 1e6:.3g} MB/s"


def measure_reading_speed(
    series: Mapping[str, FrameSeries], chunk_steps: int, step_seconds: float, workers: int
) -> ReadingSpeed | None:
    """Compute the reading rate that a run needs, and measure its disk."""
    sizes = [_frame_bytes(one) for one in series.values()]
    if not all(sizes) or step_seconds <= 0:
        return None
    step_bytes = sum(sizes) * (1 + 5 / chunk_steps)
    # those from the end of the record first: they are the least likely to be remembered
    frames = zip(*(reversed(one.entries) for one in series.values()))
    paths = dict.fromkeys(entry.path for frame in frames for entry in frame if entry is not None)
    return ReadingSpeed(step_bytes, step_bytes / step_seconds, workers, _try_disk(paths))


def _frame_bytes(series: FrameSeries) -> float:
    """Bytes that a frame takes on the disk, on average."""
    entries = [entry for entry in series.entries if entry is not None]
    paths = {entry.path for entry in entries}
    return sum(file_size(path) for path in paths) / len(entries) if entries else 0.0


def file_size(path: str) -> int:
    """Bytes of a file; 0 of one that is not there."""
    try:
        return Path(path).stat().st_size
    except OSError:
        return 0


def _try_disk(paths: Iterable[str]) -> float | None:
    """Bytes/s of reading files that the system is asked to forget before; None if there is too little."""
    if not hasattr(os, "posix_fadvise"):
        return None
    count, spent = 0, 0.0
    for path in filter(os.path.isfile, paths):  # a pipe would be waited for
        # a frame that cannot be read is reported elsewhere
        with suppress(OSError), open(path, "rb", buffering=0) as stream:
            os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            piece = bytes(_PIECE)
            while len(piece) == _PIECE and spent < _SAMPLE_SECONDS and count < _SAMPLE_BYTES:
                since = time.perf_counter()
                piece = stream.read(_PIECE)
                spent += time.perf_counter() - since
                count += len(piece)
        if spent >= _SAMPLE_SECONDS or count >= _SAMPLE_BYTES:
            break
    return count / spent if count >= _LEAST_BYTES and spent > 0 else None
