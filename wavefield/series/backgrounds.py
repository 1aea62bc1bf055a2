"""Compute, read and subtract the static background of each camera (floor, reflections, hot pixels)."""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.atomic_write import Product, check_writable
from wavefield.errors import ExperimentError, FrameError
from wavefield.images import read_image, write_image
from wavefield.sampling import evenly_spaced
from wavefield.series.frames import FrameSeries

Image = NDArray[Any]


def mean_image(series: FrameSeries, frames: int) -> Image:
    """Return the mean, (row, column), of at most `frames` evenly spaced frames of a camera.
    It has the type of the frames. Bad frames are left out; FrameError if all chosen frames are bad."""
    total, count = np.zeros(series.shape), 0
    for index in evenly_spaced(len(series), frames):
        image = series.read(int(index)).image
        if image is not None:
            total, count = total + image, count + 1
    if not count:
        raise FrameError(f"{series.camera}: none of the frames can be read, so there is no background")
    mean = total / count
    return np.asarray(np.rint(mean) if np.dtype(series.dtype).kind in "ui" else mean).astype(series.dtype)


def read_backgrounds(
    named: str | Mapping[str, str] | None,
    cameras: Iterable[str],
    resolve: Callable[[str], Path],
    experiment: Path,
) -> dict[str, Image]:
    """Read the background images, (row, column), and return them by camera.
    `named` is one file name for all cameras, with ``{camera}``, or a name by camera; a camera without a name
    is left out. `resolve` turns a name into a path. ExperimentError if an image cannot be read."""
    out = {}
    for name in cameras:
        file = named if isinstance(named, str) else (named or {}).get(name)
        if file is None:
            continue
        try:
            out[name] = read_image(resolve(file.replace("{camera}", name)))
        except FrameError as error:
            raise ExperimentError(
                f"{experiment}: background: {error}; `wavefield background {experiment.name}` writes it"
            ) from None
    return out


def refuse_other_images(
    background: Image, name: str, shape: tuple[int, ...], dtype: str, experiment: Path
) -> None:
    """Raise ExperimentError if the `background` of the camera `name` differs from its frames.
    Frames have the given `shape` (rows, columns) and `dtype`; the message names the file `experiment`."""
    if background.shape != shape or background.dtype != dtype:
        raise ExperimentError(
            f"{experiment}: background of {name}: it is {background.shape[1]} x {background.shape[0]} "
            f"{background.dtype}, the frames of {name} are {shape[1]} x {shape[0]} {dtype}; run "
            f"`wavefield background {experiment.name}` again"
        )


def with_backgrounds(
    series: Mapping[str, FrameSeries],
    named: str | Mapping[str, str] | None,
    resolve: Callable[[str], Path],
    experiment: Path,
) -> dict[str, FrameSeries]:
    """Return copies of `series`, by camera, that subtract the camera's background from each frame they read.
    ExperimentError if a background does not fit the frames. For other arguments see `read_backgrounds`."""
    images = read_backgrounds(named, series, resolve, experiment)
    for name, image in images.items():
        refuse_other_images(image, name, series[name].shape, series[name].dtype, experiment)
    return {name: replace(one, background=images.get(name)) for name, one in series.items()}


def checksums(series: Mapping[str, FrameSeries]) -> dict[str, str]:
    """Return the checksum of each camera's background image, by camera; cameras without one are left out."""
    return {
        name: hashlib.sha256(np.ascontiguousarray(one.background).tobytes()).hexdigest()[:16]
        for name, one in series.items()
        if one.background is not None
    }


def write_backgrounds(
    series: Mapping[str, FrameSeries], folder: Path, frames: int, source: str
) -> list[Path]:
    """Write the mean of `frames` frames of each camera to `folder`/CAMERA.tif, and return the paths.
    StoreError if a file exists, unless it is an unchanged background of the same experiment, `source`."""
    product = Product("background", source)
    files = {name: folder / f"{name}.tif" for name in series}
    for file in files.values():
        check_writable(file, product)
    for name, one in series.items():
        write_image(files[name], mean_image(one, frames), product)
    return list(files.values())
