"""The frame rate that recordings and videos themselves state."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from wavefield.errors import ExperimentError, FrameError
from wavefield.series.formats import VIDEO_ENDINGS, file_of, open_recording
from wavefield.series.formats.video import Video

RATE_TOLERANCE = 1e-3  # of a rate: cameras round theirs


def recorded_rates(cameras: Mapping[str, object], folder: Path) -> dict[str, float]:
    """Frame rates that recordings state, by camera; the cameras are as in the experiment file."""
    return _rates(cameras, folder, videos=False)


def video_rates(cameras: Mapping[str, object], folder: Path) -> dict[str, float]:
    """Playback rates of cameras whose images are videos; those of high-speed cameras are not frame rates."""
    return _rates(cameras, folder, videos=True)


def video_rotations(cameras: Mapping[str, object], folder: Path) -> dict[str, int]:
    """Degrees by which videos state that they are to be turned, by camera; frames are read as stored."""
    out: dict[str, int] = {}
    for name, images in _images(cameras):
        paths = recordings_of(images, name, folder)
        if paths and is_video(paths[0]):
            try:
                video = Video(paths[0])
            except FrameError:  # reported when the images are opened
                continue
            out |= {name: video.rotation} if video.rotation else {}
            video.close()
    return out


def _rates(cameras: Mapping[str, object], folder: Path, videos: bool) -> dict[str, float]:
    rates = {}
    for name, images in _images(cameras):
        paths = recordings_of(images, name, folder)
        if not paths or is_video(paths[0]) != videos:
            continue
        try:
            recording = open_recording(paths[0])
        except FrameError:  # reported when the images are opened
            continue
        if recording.rate:
            rates[name] = recording.rate
        recording.close()
    return rates


def is_video(path: Path) -> bool:
    """Whether a path is that of a video, whose times are those of the playback."""
    return path.suffix.lower() in VIDEO_ENDINGS


def _images(cameras: Mapping[str, object]) -> Iterator[tuple[str, object]]:
    """Names of cameras, and the images of each as in the experiment file."""
    for name, camera in cameras.items():
        yield str(name), camera.get("images") if isinstance(camera, Mapping) else camera


def recordings_of(images: object, camera: str, folder: Path) -> list[Path]:
    """The recordings that hold a camera's images, one after the other; none if any is of another kind."""
    names = images if isinstance(images, list) else [images]
    paths = [folder / name.replace("{camera}", camera) for name in names if isinstance(name, str)]
    return paths if len(paths) == len(names) and all(map(file_of, paths)) else []


def one_rate(rates: Mapping[str, float], path: Path) -> float | None:
    """The rate that all recordings or videos state; None if there are none."""
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
    """Whether two rates are the same but for rounding.

    Examples
    --------
    >>> is_alike(500.0, 500.2), is_alike(500.0, 250.0)
    (True, False)
    """
    return abs(one - other) <= RATE_TOLERANCE * abs(other)
