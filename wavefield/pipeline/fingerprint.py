"""Compare the images with those that a cube was begun with, by some frames of each camera."""

import zlib
from collections.abc import Mapping

import numpy as np

from wavefield.errors import StoreError
from wavefield.sampling import from_first_to_last
from wavefield.series import FrameSeries

SAMPLE_FRAMES = 3  # frames of each camera: first, middle and last

Fingerprints = dict[str, dict[str, int]]


def fingerprints(series: Mapping[str, FrameSeries]) -> Fingerprints:
    """Checksums of the grey levels of some frames."""
    out: Fingerprints = {}
    for name, frames in series.items():
        read = {str(k): frames.read(k).image for k in from_first_to_last(len(frames), SAMPLE_FRAMES)}
        out[name] = {k: _sum(image) for k, image in read.items() if image is not None}
    return out


def _sum(image: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(image).tobytes())


def check_images(
    store: str, begun: Mapping[str, Mapping[str, int]], series: Mapping[str, FrameSeries]
) -> None:
    """Refuse to go on with other images than a cube was begun with."""
    for name, sums in begun.items():
        for index, requested in sums.items():
            frames = series.get(name)
            image = frames.read(int(index)).image if frames is not None else None
            if frames is not None and image is not None and _sum(image) != requested:
                raise StoreError(
                    f"{store} was begun with other images: {frames.place(int(index))} is not what it was; "
                    "write to another store with -o, or remove this one"
                )
