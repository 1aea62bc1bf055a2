"""Small image series for the tests."""

from pathlib import Path

import numpy as np

from wavefield.errors import FrameError
from wavefield.images import write_image
from wavefield.series.readers import FrameEntry, close_files, count_images, read_entry


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


def complaint(path: Path) -> str:
    """What reading the images of a file ends with: nothing, or one sentence; anything else fails the test."""
    try:
        kind, count = count_images(path)
        for k in range(min(count, 3)):
            assert read_entry(FrameEntry(kind, str(path), k)).ndim == 2
    except FrameError as error:
        return str(error)
    finally:
        close_files()
    return ""


def damaged(whole: bytes, k: int, rng: np.random.Generator, reach: int = 10**9) -> bytes:
    """Bytes that are cut off, or changed in thirty places within reach of the beginning."""
    data = bytearray(whole[: rng.integers(0, len(whole))] if k % 2 else whole)
    for place in rng.integers(0, max(1, min(len(data), reach)), 0 if k % 2 else 30):
        data[place] = int(rng.integers(0, 256))
    return bytes(data)


def count_reported(path: Path, reach: int = 10**9) -> int:
    """How many of fifty damages of a file are reported, all of them in one sentence that names it."""
    whole, rng, reported = path.read_bytes(), np.random.default_rng(1), 0
    assert complaint(path) == ""
    for k in range(50):
        path.write_bytes(damaged(whole, k, rng, reach))
        words = complaint(path)
        reported += bool(words)
        assert not words or path.stem in words
        assert "\n" not in words
    return reported
