"""Images of a folder by their names: which are one series, what numbers its frames, what names its camera."""

import os
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from wavefield.errors import ExperimentError

IMAGE_ENDINGS = (".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg")
_OF_A_CAMERA = re.compile(r"(cam|camera|kamera|caméra|view)[_\-. ]?$", re.IGNORECASE)  # before a number
_OF_A_FRAME = re.compile(r"frame[_\-. ]?$", re.IGNORECASE)
_FRAME = re.compile(r"\{frame[^}]*\}")
_BETWEEN_WORDS = re.compile(r"(?<!cam)(?<!camera)(?<!kamera)(?<!view)[_\-. ]", re.IGNORECASE)
_YAML_WORDS = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}


@dataclass(frozen=True)
class NumberedImages:
    """Images whose names differ in one number."""

    pattern: str  # Path from the folder, with ``{frame}`` for the number
    numbers: tuple[int, ...]  # The numbers, in order

    @property
    def step(self) -> int:
        """Usual difference of two numbers."""
        gaps = sorted(b - a for a, b in zip(self.numbers, self.numbers[1:]))
        return gaps[len(gaps) // 2] if gaps else 1

    @property
    def wildcard(self) -> str:
        """The pattern with a star for the number."""
        return _FRAME.sub("*", self.pattern)


def files_below(folder: Path) -> Iterator[Path]:
    """Files in a folder and in those below, of linked folders too; stores are passed over."""
    entered: set[str] = set()
    for here, folders, names in os.walk(folder, followlinks=True):
        entered.add(os.path.realpath(here))
        folders[:] = [
            name
            for name in sorted(folders)
            if not name.endswith(".zarr") and os.path.realpath(os.path.join(here, name)) not in entered
        ]
        yield from (path for name in names if (path := Path(here, name)).is_file())


def image_paths(folder: Path) -> list[str]:
    """Paths of the images in a folder and in those below, from that folder."""
    if not folder.is_dir():
        raise ExperimentError(f"{folder} is no folder; name the one that contains the images")
    return sorted(
        path.relative_to(folder).as_posix()
        for path in files_below(folder)
        if path.suffix.lower() in IMAGE_ENDINGS
    )


def find_series(paths: Sequence[str]) -> list[NumberedImages]:
    """Series of numbered images among paths, wherever in the name the number of the frame is.
    The frame's number is the one with the most values. Where each name has another, what else varies (a time,
    say) gets a star; else names that differ in further numbers are of further series.
    """
    alike: dict[tuple[str, ...], list[list[str]]] = defaultdict(list)
    for path in paths:
        folder, _, name = path.rpartition("/")
        stem, dot, ending = name.rpartition(".")
        parts = re.split(r"(\d+)", stem)
        if len(parts) > 1:
            parts[0] = f"{folder}/{parts[0]}" if folder else parts[0]
            parts[-1] += dot + ending
            alike[tuple(parts[::2])].append(parts)
    numbers: dict[str, list[int]] = defaultdict(list)
    for texts, names in alike.items():
        k = _frame_column(texts, names)
        zeros = any(len(parts[k]) > 1 and parts[k].startswith("0") for parts in names)
        width = min(len(parts[k]) for parts in names)
        frame = f"{{frame:0{width}d}}" if zeros else "{frame}"
        unique = len({parts[k] for parts in names}) == len(names) > 1
        others = [
            j
            for j in range(1, len(names[0]), 2)
            if j != k and len({parts[j] for parts in names}) > 1 and not _OF_A_CAMERA.search(texts[j // 2])
        ]
        for parts in names:
            shown = ["*" if unique and j in others else part for j, part in enumerate(parts)]
            numbers["".join([*shown[:k], frame, *shown[k + 1 :]])].append(int(parts[k]))
    return [NumberedImages(pattern, tuple(sorted(found))) for pattern, found in sorted(numbers.items())]


def _frame_column(texts: Sequence[str], names: Sequence[Sequence[str]]) -> int:
    """Which part of names that differ in numbers alone is the number of the frame."""

    def rank(k: int) -> tuple[bool, bool, int, int]:
        values, before = len({parts[k] for parts in names}), texts[k // 2]
        # one that follows the word frame comes before others, one that follows a word for a camera after them
        return not _OF_A_CAMERA.search(before), values > 1 and bool(_OF_A_FRAME.search(before)), values, k

    return max(range(1, len(names[0]), 2), key=rank)


def camera_names(patterns: Sequence[str]) -> list[str]:
    """Names of cameras: the words in which the patterns of their images differ, else cam1, cam2, ..."""
    paths = [_FRAME.sub("", pattern.rpartition(".")[0]) for pattern in patterns]
    usual = [f"cam{k}" for k in range(1, len(patterns) + 1)]
    folders = [path.split("/")[:-1] for path in paths]
    words = [_BETWEEN_WORDS.split(path.rpartition("/")[2]) for path in paths]
    apart: list[tuple[str, ...]] = []
    different: list[tuple[str, ...]] = []
    for rows in (folders, words, [a + b for a, b in zip(folders, words)]):
        if not apart and len({len(row) for row in rows}) == 1:
            different = [column for column in zip(*rows, strict=True) if len(set(column)) > 1]
            apart = [column for column in different if len(set(column)) == len(patterns)]
    apart = apart[:1] or different
    names = [_as_name("-".join(row)) for row in zip(*apart, strict=True)]
    return names if len(set(names)) == len(patterns) and all(names) else usual


def _as_name(words: str) -> str:
    """A word that YAML and file systems take for a name; empty if there is none."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", words).strip("-")
    if name.isdecimal():
        return f"cam{name}"
    return f"cam-{name}" if name.lower() in _YAML_WORDS or re.match(r"[0-9_]", name) else name


def common_patterns(patterns: Sequence[str], cameras: Sequence[str]) -> list[str]:
    """The patterns with ``{camera}`` for the camera that fit all of these names; none if some do not.

    Examples
    --------
    >>> common_patterns(["calib/left/t_*.tif", "calib/right/t_*.tif"], ["left", "right"])
    ['calib/{camera}/t_*.tif']
    """
    of: dict[str, set[str]] = defaultdict(set)
    for pattern in patterns:
        for camera in sorted(cameras, key=len, reverse=True):
            general = re.sub(rf"(?<![A-Za-z0-9]){re.escape(camera)}(?![A-Za-z0-9])", "{camera}", pattern)
            if general != pattern:
                of[general].add(camera)
                break
        else:
            return []
    return list(of) if all(found == set(cameras) for found in of.values()) else []
