"""Find images by the names in the experiment file: numbered frames, and images of the calibration target.

The number of a frame is in the file's name, is the index of the image in a file of many images, or follows
from a time stamp. If the experiment file has a list of files, images are numbered through the whole list. A
number never comes from a file's position in its folder, because a missing file would shift the others.
"""

import glob
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import CalibrationError, ExperimentError, FrameError
from wavefield.sampling import from_first_to_last
from wavefield.series.experiment_parts import CalibrationSection
from wavefield.series.formats.arrays import is_remote
from wavefield.series.frames import FrameSeries
from wavefield.series.readers import FrameEntry, Kind, count_images, read_entry

Numbered = dict[int, FrameEntry]  # frames of a camera by frame number
Images = str | Sequence[str | None]  # as in the experiment file

MAX_FRAMES = 5_000_000  # frames of a record; more are a damaged header
MAX_NUMBERS_PER_FRAME = 100  # range of frame numbers over the number of frames; more is a mistake
FRAME = re.compile(r"\{frame(?::0?(\d*)d?)?\}")


def number_frames(images: Images, folder: Path, camera: str) -> Numbered:
    """Return the frames of a camera by frame number, from its entry `images` in the experiment file.
    Relative names start from `folder`. ExperimentError if images are missing or cannot be numbered."""
    if not isinstance(images, str):
        return _from_list(images, folder, camera)
    name = images.replace("{camera}", camera)
    path = folder / name
    if FRAME.search(name):
        prefix = str(path.parent) + os.sep
        names = _names(path, camera)
        return {number: FrameEntry("file", prefix + name) for number, name in sorted(names.items())}
    if re.search(r"[*?%#{]", path.name) and not path.exists():
        raise ExperimentError(
            f"images of {camera}: {name}: write {{frame}} where the number of the frame is, as in "
            f"img_{{frame:05d}}{path.suffix}"
        )
    source = name if is_remote(name) else str(path)  # a path would lose one slash of an address
    kind, count = _count_images(source, camera)
    return {i: FrameEntry(kind, source, i) for i in range(count)}


def _count_images(path: str | Path, camera: str) -> tuple[Kind, int]:
    """Return ("file" or "images", number of images) of a path; ExperimentError if bad or over 5 million."""
    try:
        kind, count = count_images(path)
    except FrameError as error:
        raise ExperimentError(f"images of {camera}: {error}") from None
    if count > MAX_FRAMES:
        raise ExperimentError(
            f"images of {camera}: {path} has {count:.3g} images by its header, more "
            f"than {MAX_FRAMES:,}: is it damaged?"
        )
    return kind, count


def _from_list(images: Sequence[str | None], folder: Path, camera: str) -> Numbered:
    """Return the frames in a list of files, by frame number; images are numbered from 0 through all files.
    An entry None, or a file that does not exist, leaves one number without a frame."""
    out: Numbered = {}
    number = 0
    for item in images:
        path = None if item is None else folder / item.replace("{camera}", camera)
        kind: Kind = "file"
        count = 1  # a gap, or a listed file that does not exist, keeps its place
        if path is not None and path.exists():
            kind, count = _count_images(path, camera)
            out |= {number + i: FrameEntry(kind, str(path), i) for i in range(count)}
        number += count
    if not out:
        raise ExperimentError(f"images of {camera}: none of the {len(images)} listed files is there")
    return out


def _names(path: Path, camera: str) -> dict[int, str]:
    """Return the file names that match the pattern `path`, such as ``img_{frame}.tif``, by frame number."""
    folder, pattern = path.parent, path.name
    try:
        names = os.listdir(folder)
    except OSError as error:
        raise ExperimentError(
            f"images of {camera}: the folder {folder} cannot be read ({error.strerror}); check its name and "
            "permissions, and that its disk is mounted"
        ) from None
    numbered = _numbers_by_mark(names, pattern, camera)
    if not numbered:
        alike = sorted(name for name in names if name.endswith(path.suffix)) or sorted(names)
        hint = f"the folder holds {alike[0]!r} and others" if alike else f"{folder} is empty"
        raise ExperimentError(f"images of {camera}: no file in {folder} fits {pattern!r}; {hint}")
    return numbered


def _numbers_by_mark(names: Sequence[str], pattern: str, camera: str) -> dict[int, str]:
    """Return the file names that match a pattern such as ``run-*-{frame}.tif``, by frame number.
    ExperimentError if two files have the same number, or if a wildcard is next to ``{frame}``."""
    parts = re.split(r"(\*|\?|\{frame[^}]*\})", pattern)
    if re.search(r"[*?]\{frame|\{frame[^}]*\}[*?]", pattern):
        raise ExperimentError(
            f"images of {camera}: {pattern} has a wildcard next to {{frame}}: put the character between them"
        )
    groups = {"*": ".*", "?": "."}
    form = re.compile(
        "".join(r"(\d+)" if p.startswith("{frame") else groups.get(p) or re.escape(p) for p in parts)
    )
    out: dict[int, str] = {}
    for name in names:
        if match := form.fullmatch(name):
            first, second = sorted((name, out.setdefault(int(match[1]), name)))
            if first != second:
                raise ExperimentError(
                    f"images of {camera}: {first!r} and {second!r} are both frame {int(match[1])}; remove or "
                    "rename one"
                )
    return out


def make_series(
    numbered: Mapping[str, Numbered], first: int, last: int, clocks: Mapping[str, NDArray[np.float64]]
) -> dict[str, FrameSeries]:
    """Return a series for each camera, with the frame numbers from `first` to `last`, both included.
    `numbered` has the cameras' frames by number; `clocks` has the times (s) of these frames, in order, for
    cameras with a clock. One frame of each camera is read, to learn the shape and type of the images."""
    out = {}
    for camera, frames in numbered.items():
        entries = [frames.get(number) for number in range(first, last + 1)]
        shape, dtype = _usual_kind(entries, camera)
        beyond = sum(number < first for number in frames), sum(number > last for number in frames)
        taken = dict(zip(sorted(frames), clocks.get(camera, ())))
        times = np.array([taken.get(number, np.nan) for number in range(first, last + 1)]) if taken else None
        out[camera] = FrameSeries(camera, first, entries, shape, dtype, beyond=beyond, times=times)
    return out


def _usual_kind(entries: Sequence[FrameEntry | None], camera: str) -> tuple[tuple[int, int], str]:
    """Return the shape (rows, columns) and type of images, from the first readable one of five tried."""
    present = [entry for entry in entries if entry is not None]
    tried = [present[k] for k in from_first_to_last(len(present), 5)] if present else []
    problem = "there are none in the range of frames"
    for entry in tried:
        try:
            image = read_entry(entry)
        except FrameError as error:
            problem = str(error)
            continue
        return (image.shape[0], image.shape[1]), str(image.dtype)
    raise ExperimentError(f"images of {camera}: none of {len(tried)} tried can be read: {problem}")


# -- images of the calibration target


def find_views(
    section: CalibrationSection, cameras: Iterable[str], folder: Path, experiment: Path
) -> dict[str, dict[str, Path]]:
    """Return the paths of the images of the calibration target in `folder`, by camera and then by pose.
    A pose (position of the target) is named by the part of the file name that varies, or ``flat`` on the
    water. CalibrationError, which names the file `experiment`, if a camera has no target image."""

    def no_images(camera: str, patterns: Sequence[str]) -> CalibrationError:
        return CalibrationError(
            f"{experiment}: no target image of {camera}: nothing in {folder} is called "
            f"{' or '.join(patterns)}; correct the calibration block"
        )

    tilted = [section.tilted] if isinstance(section.tilted, str) else section.tilted
    out: dict[str, dict[str, Path]] = {}
    for camera in cameras:
        poses: dict[str, Path] = {}
        for pattern in tilted:
            for pose, path in _target_images(folder, pattern, camera):
                other = poses.setdefault(pose, path)
                if other != path:
                    raise CalibrationError(
                        f"{experiment}: both {other} and {path} would be pose {pose!r}; rename one of them, "
                        "or narrow `tilted`"
                    )
        if not poses:
            raise no_images(camera, tilted)
        if section.flat:
            flat = [path for _, path in _target_images(folder, section.flat, camera)]
            if len(flat) > 1:
                raise CalibrationError(
                    f"{experiment}: flat: {section.flat} names {len(flat)} images of {camera}; name one"
                )
            poses = {pose: path for pose, path in poses.items() if path not in flat}
            poses |= dict.fromkeys(["flat"], flat[0]) if flat else {}
        out[camera] = poses
    if section.flat and not any("flat" in poses for poses in out.values()):
        raise no_images("any camera", [section.flat])
    return out


def _target_images(folder: Path, pattern: str, camera: str) -> Iterator[tuple[str, Path]]:
    """Yield the pose (position of the target, as text) and the path of each target image of a camera.
    The pose is the text that the wildcards of `pattern` match, with the text around them, so it is the same
    in all cameras. A leading minus sign is kept, because a target may be moved from -3 mm to 3 mm."""
    named = pattern.replace("{camera}", glob.escape(camera))
    one_each = re.sub(r"\[.[^]]*\]", "?", pattern)  # a set such as [0-9] matches one character
    groups = {"*": "(.*?)", "?": "(.)"}
    parts = re.split(r"(\*+|\?)", one_each.replace("{camera}", camera))
    expression = re.compile(
        "".join(groups[part[0]] if part[:1] in groups else re.escape(part) for part in parts)
    )
    *folders, name = one_each.replace("{camera}", "").split("/")
    # folders with wildcards are part of the pose as well
    template = [re.sub(r"\*+", "*", part) for part in (*folders, Path(name).stem) if re.search(r"[*?]", part)]
    words = [word.strip("_- ") for word in template] or [Path(name).stem.strip("_- ")]
    for file in sorted(glob.glob(str(Path(glob.escape(str(folder))) / named))):
        match = expression.fullmatch(os.path.relpath(file, folder)) or expression.fullmatch(file)
        pose = "_".join(words)
        if match:
            texts = re.split(r"[*?]", pose)
            pose = "".join(chain.from_iterable(zip(texts, (*match.groups()[: len(texts) - 1], ""))))
        yield pose.lstrip("_ ").rstrip("_- ") or Path(file).stem, Path(file)
