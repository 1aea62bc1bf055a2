"""Small image series for the tests."""

from pathlib import Path

import numpy as np

from wavefield.images import write_image


def number_image(number: int, shape: tuple[int, int] = (6, 8)) -> np.ndarray:
    """An image that contains its frame number."""
    image = np.arange(shape[0] * shape[1], dtype=np.uint8).reshape(shape)
    image[0, 0] = number % 256
    return image


def write_frames(folder: Path, numbers, pattern: str = "img_{:05d}.tif", shape=(6, 8)) -> None:
    for number in numbers:
        write_image(folder / pattern.format(number), number_image(number, shape))


HEAD = """\
name: basin
frame_rate: 20.0
cameras:
"""


def write_experiment(folder: Path, cameras: str, rest: str = "") -> Path:
    path = folder / "experiment.yaml"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(HEAD + "".join(f"  {line}\n" for line in cameras.splitlines()) + rest)
    return path
