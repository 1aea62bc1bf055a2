"""The background of a camera, which its frames have in common: a floor, reflections, hot pixels."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import ExperimentError, FrameError
from wavefield.images import read_image, write_image
from wavefield.sampling import evenly_spaced
from wavefield.series.frames import FrameSeries

Image = NDArray[Any]


def mean_image(series: FrameSeries, frames: int) -> Image:
    """Mean of so many evenly spaced frames, (row, column), in the type of the frames."""
    total, count = np.zeros(series.shape), 0
    for index in evenly_spaced(len(series), frames):
        image = series.read(int(index)).image
        if image is not None:
            total, count = total + image, count + 1
    if not count:
        raise FrameError(f"{series.camera}: none of the frames can be read, so there is no background")
    mean = total / count
    return np.asarray(np.rint(mean) if np.dtype(series.dtype).kind in "ui" else mean).astype(series.dtype)


def with_backgrounds(
    series: Mapping[str, FrameSeries],
    named: str | Mapping[str, str],
    resolve: Callable[[str], Path],
    experiment: Path,
) -> dict[str, FrameSeries]:
    """Series whose frames are read less the backgrounds that an experiment file names."""
    out = dict(series)
    for name, one in series.items():
        file = named if isinstance(named, str) else named.get(name)
        if file is None:
            continue
        path = resolve(file.replace("{camera}", name))
        try:
            image = read_image(path)
        except FrameError as error:
            raise ExperimentError(
                f"{experiment}: background: {error}; `wavefield background {experiment.name}` writes it"
            ) from None
        if image.shape != one.shape or image.dtype != one.dtype:
            raise ExperimentError(
                f"{experiment}: background: {path} is {image.shape[1]} x {image.shape[0]} {image.dtype}, the "
                f"frames of {name} are {one.shape[1]} x {one.shape[0]} {one.dtype}; run "
                f"`wavefield background {experiment.name}` again"
            )
        out[name] = replace(one, background=image)
    return out


def checksums(series: Mapping[str, FrameSeries]) -> dict[str, str]:
    """Checksums of the backgrounds, by camera, for a recipe."""
    return {
        name: hashlib.sha256(np.ascontiguousarray(one.background).tobytes()).hexdigest()[:16]
        for name, one in series.items()
        if one.background is not None
    }


def write_backgrounds(series: Mapping[str, FrameSeries], folder: Path, frames: int) -> list[Path]:
    """Write the mean image of every camera into a folder; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name, one in series.items():
        files.append(folder / f"{name}.tif")
        write_image(files[-1], mean_image(one, frames))
    return files
