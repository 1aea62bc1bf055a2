"""Read videos with FFmpeg (PyAV); a frame is found by its time stamp in the file.

Pixels are the luminance as stored; a rotation for display that the file states is not applied.
"""

from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from wavefield.errors import FrameError
from wavefield.images import grey
from wavefield.series.formats.recordings import Pixels, Recording, usual_interval
from wavefield.text import one_line

UNTIMED = (".avi",)  # containers without presentation times: compressed frames are counted by decoding


class Video(Recording):
    """The frames of a video as a `Recording`, without frames that the file marks as not to be shown."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._open()
        packets = [packet for packet in self._container.demux(self._stream) if packet.size]
        shown = [packet for packet in packets if not packet.is_discard]
        stamps = sorted(packet.pts for packet in shown if packet.pts is not None)
        by_time = path.suffix.lower() not in UNTIMED or all(packet.is_keyframe for packet in packets)
        self._timed = by_time and len(stamps) == len(shown) and len(set(stamps)) == len(stamps)
        # presentation and decoding times of the frames that are coded without others
        self._keys = [
            (p.pts, p.pts if p.dts is None else p.dts) for p in packets if p.is_keyframe and p.pts is not None
        ]
        self._rewind()
        if self._timed:
            self._stamps = stamps
        else:
            self._stamps = list(range(sum(1 for _ in self._decoded())))
            self._rewind()
        self.count = len(self._stamps)
        if not self.count:
            raise FrameError(f"{path} holds not one complete image: it is empty or truncated")
        base = float(self._stream.time_base or 1.0)
        times = np.array(self._stamps, float) * base - self._stamps[0] * base
        if self._timed and self.count > 1:
            self.rate, self._times = float(f"{1 / usual_interval(times):.4g}"), times
        else:
            self.rate = float(self._stream.guessed_rate or self._stream.average_rate or 0) or None
        image = self.read(0)
        self.shape = (image.shape[0], image.shape[1])
        self._rewind()
        self.rotation = int(getattr(next(self._decoded()), "rotation", 0))
        self._rewind()

    def _open(self) -> None:
        """Open the file and choose its first video stream; FrameError if that fails."""
        try:
            self._container = av.open(str(self.path))
            self._stream = self._container.streams.video[0]
        except (av.FFmpegError, IndexError, ValueError) as error:
            raise FrameError(
                f"{self.path} cannot be read as a video ({one_line(error)}); convert it to PNG or TIFF frames"
            ) from None
        self._stream.thread_type = "AUTO"

    def _decoded(self) -> Any:
        """Yield decoded frames from the current position until the file ends or is damaged."""
        try:
            yield from self._container.decode(self._stream)
        except (av.FFmpegError, ValueError):
            return  # what follows damage is not decoded

    def _rewind(self) -> None:
        """Open the file again, so that the next frame decoded is the first."""
        self._container.close()
        self._open()
        self._frames, self._next = self._decoded(), 0

    def _read(self, index: int) -> Pixels:
        stamp = self._stamps[index]
        if index < self._next or (self._timed and self._key(stamp) > self._key(self._stamps[self._next])):
            self._seek(stamp)
        for frame in self._frames:
            place = frame.pts if self._timed else self._next
            self._next = index + 1 if place == stamp else self._next + (not self._timed)
            if place == stamp:
                return _luminance(frame)
            if self._timed and place is not None and place > stamp:
                break
        self._rewind()
        raise FrameError(f"{self.path}, image {index}: cannot be decoded; is it damaged?")

    def _key(self, stamp: int) -> int:
        """Return the time, in clock ticks, of the last key frame (coded without others) up to `stamp`."""
        return max((pts for pts, _ in self._keys if pts <= stamp), default=self._stamps[0])

    def _seek(self, stamp: int) -> None:
        """Move to the last key frame up to the time `stamp`, in clock ticks, or else to the first frame."""
        key = dict(self._keys).get(self._key(stamp))
        if not self._timed or key is None:
            self._rewind()
            return
        try:
            self._container.seek(key, stream=self._stream)
        except av.FFmpegError:
            self._rewind()
            return
        self._frames = self._decoded()

    def close(self) -> None:
        """Close the file."""
        self._container.close()


def _luminance(frame: Any) -> NDArray[Any]:
    """Return the luminance of a decoded frame, (row, column), as 8 or 16 bits; colours become grey."""
    form = frame.format
    if form.is_rgb or form.has_palette:
        return grey(frame.to_ndarray(format="rgb24"))
    if not (form.is_planar or form.name.startswith("gray")):  # samples of all channels in turn
        frame = frame.reformat(format="gray")
    plane, bits = frame.planes[0], frame.format.components[0].bits
    order = ">" if frame.format.is_big_endian and bits > 8 else "<"
    rows = np.frombuffer(plane, "u1" if bits <= 8 else f"{order}u2").reshape(frame.height, -1)
    out = rows[:, : frame.width]
    return np.ascontiguousarray(out, out.dtype.newbyteorder("="))
