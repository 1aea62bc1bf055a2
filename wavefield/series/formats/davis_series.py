"""Read sets of LaVision's DaVis: a `.set` file, and `.im7` buffers in the folder of the same name."""

import re
from pathlib import Path

from wavefield.errors import FrameError
from wavefield.images.davis_image import count_frames, read_buffer
from wavefield.series.formats.recording import Pixels, Recording, no_times, refuse_index


class _Set:
    """A `Recording` of the image with index `frame`, from 0, of each buffer (.im7 file) of a DaVis set."""

    def __init__(self, path: Path, buffers: list[Path], frame: int) -> None:
        self.path, self._buffers, self._frame = path, buffers, frame
        first = read_buffer(buffers[0], frame)
        self.count, self.shape = len(buffers), (first.shape[0], first.shape[1])
        self.rate: float | None = None
        self.times = no_times

    def read(self, index: int) -> Pixels:
        """Return the image of the buffer at an index from 0, (row, column); FrameError if that fails."""
        refuse_index(index, self.count, self.path)
        return read_buffer(self._buffers[index], self._frame)

    def close(self) -> None:
        """Do nothing: no file stays open."""


def open_davis(path: Path) -> Recording:
    """Open a DaVis set, ``run.set``, or ``run.set/1`` for the second image of each of its buffers.
    FrameError if there are no buffers (.im7 files) or no such image in them."""
    name = path if path.suffix.lower() == ".set" else path.parent
    folder = name.with_suffix("")
    buffers = _in_order(list(folder.glob("*.im7")))
    if not buffers:
        raise FrameError(f"{name} has no .im7 in the folder {folder.name} next to it: copy both")
    count = count_frames(buffers[0])
    if path == name and count > 1:
        raise FrameError(f"{name} has {count} images in each buffer: name one, as {name.name}/0")
    inside = "0" if path == name else path.name
    if not inside.isdecimal() or int(inside) >= count:
        raise FrameError(f"{name} has images 0 to {count - 1} in each buffer, none called {inside!r}")
    return _Set(path, buffers, int(inside))


def _in_order(buffers: list[Path]) -> list[Path]:
    """Return the paths of buffers sorted by the number at the end of their names, or else as text.
    A number that is missing in between gets the path that its file should have, so that reading it fails."""
    ends = [re.search(r"(?<!\d)\d{1,6}$", path.stem) for path in buffers]
    numbered = {int(end[0]): path for end, path in zip(ends, buffers) if end}
    if not buffers or len(numbered) < len(buffers):
        return sorted(buffers)
    first, last = min(numbered), max(numbered)
    stem, folder = numbered[first].stem.rstrip("0123456789"), buffers[0].parent
    width = len(numbered[first].stem) - len(stem)
    return [numbered.get(n, folder / f"{stem}{n:0{width}d}.im7") for n in range(first, last + 1)]
