"""Propose an experiment file for a folder of images, with a comment on every guess."""

import os
import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wavefield.errors import ExperimentError
from wavefield.images import ENDINGS

MIN_IMAGES = 3  # images of a record; fewer are not taken for one
# words in the names of images of targets or still water, in English, French and German
_NO_WAVES = re.compile(
    r"calib|kalib|(?<![a-z])cal(?![a-z])|target|board|checker|charuco|tilt|plate|grid|mire|eich"
    r"|rest|still|repos|ruhe|(?<![a-z])(flat|level|plan|flach)(?![a-z])",
    re.IGNORECASE,
)


_NOTE = """\
# Proposed from the images in {folder}; check every line, then run `wavefield check`.
name: {name}
frame_rate:                   # TO FILL IN: Hz, such as 20.0; image files do not contain it
cameras:                      # offset: the first image is frame 0, if all cameras began together
{cameras}
{others}# calibration:                # images of a target, which `wavefield calibrate` turns into rig.yaml
#   target: {{kind: chessboard, mesh: 0.03, shape: [9, 6]}}
#   tilted: "calib/{{camera}}/tilt_*.tif"
#   flat: "calib/{{camera}}/flat.tif"
# rig: rig.yaml               # an existing rig, instead of a calibration
# rest: "rest/{{camera}}/img_{{frame:05d}}.tif"     # images of still, seeded water level the rig
grid: auto                    # what all cameras see; or {{x: [..], y: [..], step: ..}} in metres
water: {{depth: }}              # TO FILL IN: metres, such as 0.70; none in deep water
# probes: probes.csv          # wave probes: a column `time`, s, and one per probe, m
"""


@dataclass(frozen=True)
class NumberedImages:
    """Numbered images of one camera: the pattern of their file names, and the numbers."""

    pattern: str  # Relative path, with ``{frame}`` for the number and ``*`` for other varying parts
    numbers: tuple[int, ...]  # The numbers, in order


def image_paths(folder: Path) -> list[str]:
    """Return the sorted paths of all images in a folder and its subfolders, relative to the folder.
    Zarr stores are skipped; links are followed. ExperimentError if the folder does not exist."""
    if not folder.is_dir():
        raise ExperimentError(f"{folder} is not a folder; name the one that contains the images")
    entered: set[str] = set()
    found: list[Path] = []
    for here, folders, names in os.walk(folder, followlinks=True):
        entered.add(os.path.realpath(here))
        folders[:] = [
            name
            for name in sorted(folders)
            if not name.endswith(".zarr") and os.path.realpath(os.path.join(here, name)) not in entered
        ]
        found += [Path(here, name) for name in names if Path(name).suffix.lower() in ENDINGS]
    return sorted(path.relative_to(folder).as_posix() for path in found if path.is_file())


def find_series(paths: Sequence[str]) -> list[NumberedImages]:
    """Group `paths` into series of numbered images, sorted by the patterns of their names.
    Among names that differ only in digits, the group of digits with the most values is the frame number.
    Other digits become ``*`` where they vary, or separate the series if frame numbers would repeat."""
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
    for names in alike.values():
        k = max(range(1, len(names[0]), 2), key=lambda k: (len({parts[k] for parts in names}), k))
        zeros = any(len(parts[k]) > 1 and parts[k].startswith("0") for parts in names)
        width = min(len(parts[k]) for parts in names)
        frame = f"{{frame:0{width}d}}" if zeros else "{frame}"
        unique = len({parts[k] for parts in names}) == len(names) > 1
        others = [j for j in range(1, len(names[0]), 2) if j != k and len({parts[j] for parts in names}) > 1]
        for parts in names:
            shown = ["*" if unique and j in others else part for j, part in enumerate(parts)]
            numbers["".join([*shown[:k], frame, *shown[k + 1 :]])].append(int(parts[k]))
    return [NumberedImages(pattern, tuple(sorted(found))) for pattern, found in sorted(numbers.items())]


def camera_names(patterns: Sequence[str]) -> list[str]:
    """Return a camera name for each pattern: its folder, if all are distinct words, or cam1, cam2, ..."""
    folders = [pattern.rpartition("/")[0].rpartition("/")[2] for pattern in patterns]
    words = {folder for folder in folders if re.fullmatch("[A-Za-z][A-Za-z0-9_]+", folder)}
    return folders if len(words) == len(patterns) else [f"cam{k}" for k in range(1, len(patterns) + 1)]


def propose(folder: str | Path) -> str:
    """Return the text of an experiment file proposed for a folder of images.

    Parameters
    ----------
    folder : path
        Folder of the images of all cameras. Each camera has a subfolder, or file names of its own.

    Returns
    -------
    str
        YAML with a comment on every guess. The user fills in what images do not tell, such as the frame rate.

    Raises
    ------
    ExperimentError
        If the folder does not contain numbered images of two cameras, three or more of each.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from wavefield.images import write_image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for camera in ("left", "right"):
    ...         for number in range(4):
    ...             write_image(Path(folder) / camera / f"img_{number:03d}.tif", np.zeros((8, 9), np.uint8))
    ...     text = propose(folder)
    >>> "left: {images" in text and "right/img_{frame:03d}.tif" in text
    True
    """
    folder = Path(folder).absolute()
    paths = image_paths(folder)
    series = find_series([path for path in paths if not _NO_WAVES.search(path)])
    waves = [one for one in series if len(one.numbers) >= MIN_IMAGES]
    if len(waves) < 2:
        present = ", ".join(one.pattern for one in find_series(paths)[:4]) or "no numbered images"
        raise ExperimentError(
            f"{folder}: numbered images of two cameras at least are needed, and there are {present}; name "
            "the folder that contains those of all cameras"
        )
    cameras = []
    for camera, one in zip(camera_names([one.pattern for one in waves]), waves):
        low, high = one.numbers[0], one.numbers[-1]
        images = f'images: "{one.pattern}"' + (f", offset: {-low}" if low else "")
        cameras.append(f"  {camera}: {{{images}}}    # {len(one.numbers)} images, {low} to {high}")
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", folder.name) or "experiment"
    left_out = sum(bool(_NO_WAVES.search(path)) for path in paths)
    return _NOTE.format(
        folder=folder.name,
        name=name,
        cameras="\n".join(cameras),
        others=f"# {left_out} images are not of waves, by their names.\n" if left_out else "",
    )
