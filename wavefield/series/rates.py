"""The frame rate that recordings themselves state."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from wavefield.errors import ExperimentError, FrameError
from wavefield.series.formats import file_of, open_recording

_ALIKE = 1e-3  # of a rate: cameras round theirs


def recorded_rates(cameras: Mapping[str, Any], folder: Path) -> dict[str, float]:
    """Frame rates that recordings state, by camera."""
    rates = {}
    for name, camera in cameras.items():
        named = camera.get("images") if isinstance(camera, Mapping) else camera
        paths = recordings_of(named, str(name), folder)
        if not paths:
            continue
        try:
            recording = open_recording(paths[0])
        except FrameError:  # told where its images are looked for
            continue
        if recording.rate:
            rates[str(name)] = recording.rate
        recording.close()
    return rates


def recordings_of(images: Any, camera: str, folder: Path) -> list[Path]:
    """The recordings that hold a camera's images, one after the other."""
    named = [images] if isinstance(images, str) else images or []
    out = []
    for one in named:
        path = folder / one.replace("{camera}", camera) if isinstance(one, str) else None
        if path is None or file_of(path) is None:
            return []
        out.append(path)
    return out


def one_rate(rates: Mapping[str, float], path: Path) -> float | None:
    """The rate that all recordings state."""
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
    return abs(one - other) <= _ALIKE * abs(other)
