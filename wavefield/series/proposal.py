"""A lab note proposed from a folder of images, with a comment on every guess."""

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from wavefield.errors import ExperimentError

IMAGE_ENDINGS = (".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg")
MIN_IMAGES = 3  # of a record
_TARGETS = re.compile(r"calib|target|board|grid|mire|eich", re.IGNORECASE)
_REST = re.compile(r"rest|still|flat_water|repos|ruhe", re.IGNORECASE)


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


def find_series(folder: Path) -> list[NumberedImages]:
    """Find the numbered images in a folder and in those below."""
    if not folder.is_dir():
        raise ExperimentError(f"{folder} is no folder; name the one that contains the images")
    numbers: dict[str, list[int]] = defaultdict(list)
    for path in folder.rglob("*"):
        name = path.relative_to(folder)
        match = re.fullmatch(r"(.*?)(\d+)(\D*)", name.name)
        if match and path.suffix.lower() in IMAGE_ENDINGS and path.is_file():
            head, digits, tail = match.groups()
            width = f":0{len(digits)}d" if digits.startswith("0") and len(digits) > 1 else ""
            numbers[(name.parent / f"{head}{{frame{width}}}{tail}").as_posix()].append(int(digits))
    for pattern in list(numbers):  # numbers that outgrew `{frame:05d}` have the pattern `{frame}`
        bare = re.sub(r"\{frame:\d+d\}", "{frame}", pattern)
        if bare != pattern and bare in numbers:
            numbers[pattern] = numbers[pattern] + numbers.pop(bare)
    return [NumberedImages(pattern, tuple(sorted(found))) for pattern, found in sorted(numbers.items())]


def propose(folder: str | Path) -> str:
    """Propose an experiment file for a folder of images.

    Parameters
    ----------
    folder : path
        Of the images, with a folder or a beginning of the names for each camera.

    Returns
    -------
    str
        YAML, with a comment on every guess; what a folder does not show is left to be filled in.

    Raises
    ------
    ExperimentError
        If there are no numbered images of two cameras.

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
    >>> "left/img_" in text and "right/img_" in text
    True
    """
    folder = Path(folder).absolute()
    series = find_series(folder)
    records = [s for s in series if not _TARGETS.search(s.pattern) and len(s.numbers) >= MIN_IMAGES]
    rest = [s for s in records if _REST.search(s.pattern)]
    waves = [s for s in records if s not in rest]
    if len(waves) < 2:
        present = ", ".join(s.pattern for s in series[:4]) or "no numbered images"
        raise ExperimentError(
            f"{folder}: numbered images of two cameras at least are needed, and there are {present}; name "
            "the folder that contains those of all cameras"
        )
    lines = [
        *_head(folder),
        *_cameras(waves),
        *_calibration([s for s in series if _TARGETS.search(s.pattern)]),
        *_rest(rest),
        "grid: auto                    # what all cameras see; or {x: [..], y: [..], step: ..} in metres",
        "water: {depth: }              # TO FILL IN: metres, such as 0.70",
        *_probes(folder),
    ]
    return "\n".join(lines) + "\n"


def _head(folder: Path) -> Iterator[str]:
    yield f"# Proposed from the images in {folder.name}; check every line, then run `wavefield check`."
    yield f"name: {re.sub(r'[^A-Za-z0-9_.-]+', '-', folder.name) or 'experiment'}"
    yield "frame_rate:                   # TO FILL IN: Hz, such as 20.0; image files do not state it"


def _cameras(records: list[NumberedImages]) -> Iterator[str]:
    yield "cameras:"
    first = min(s.numbers[0] for s in records)
    for k, one in enumerate(records, 1):
        low, high, step = one.numbers[0], one.numbers[-1], one.step
        remark = f"{len(one.numbers)} images, {low} to {high}"
        offset = -low  # time 0 is that of the first image, as the clocks of probes mostly have it
        if step > 1:
            remark += f", every {step}th number: are {step - 1} in between missing?"
        elif len(one.numbers) < high - low + 1:
            remark += f", {high - low + 1 - len(one.numbers)} missing"
        more = f", offset: {offset}" if offset else ""
        if low > first:
            remark += f"; begins {low - first} later than another: the same moment, or missing frames?"
        yield f'  cam{k}: {{images: "{one.pattern}"{more}}}    # {remark}'


def _calibration(targets: list[NumberedImages]) -> Iterator[str]:
    if not targets:
        yield "# calibration: no target images were found; name them here, or a rig: `rig: rig.yaml`"
        return
    yield "calibration:"
    yield "  target: {kind: , mesh: }    # TO FILL IN: such as chessboard, 0.03 (metres), shape: [9, 6]"
    names = [re.sub(r"\{frame[^}]*\}", "*", s.pattern) for s in targets]
    pattern = _common_pattern(names)
    if pattern:
        yield f'  tilted: "{pattern}"      # from {", ".join(names)}; the folder names the camera'
    else:
        listed = ", ".join(f'"{name}"' for name in names)
        yield f"  tilted: [{listed}]      # put {{camera}} where a name contains the camera"


def _common_pattern(names: list[str]) -> str | None:
    """The one pattern that all names have with ``{camera}`` for the camera; None if there is none."""
    general = {re.sub(r"(?i)cam(era)?[_-]?\d+", "{camera}", name) for name in names}
    pattern = general.pop()
    return pattern if not general and "{camera}" in pattern else None


def _rest(records: list[NumberedImages]) -> Iterator[str]:
    if not records:
        yield '# rest: "rest/{camera}/img_{frame:05d}.tif"     # images of still, seeded water level the rig'
        return
    patterns = [s.pattern for s in records]
    named_alike = all(f"cam{k}" in pattern for k, pattern in enumerate(patterns, 1))  # as this proposal does
    pattern = _common_pattern(patterns)
    if pattern and named_alike:
        yield f'rest: "{pattern}"      # still water? `wavefield calibrate` levels the rig by it'
        return
    listed = ", ".join(f'cam{k}: "{pattern}"' for k, pattern in enumerate(patterns, 1))
    yield f"rest: {{{listed}}}      # perhaps still water; is each of its own camera?"


def _probes(folder: Path) -> Iterator[str]:
    tables = sorted(p for p in folder.rglob("*") if p.suffix.lower() in (".csv", ".txt") and p.is_file())
    for path in tables[:1]:
        try:
            with path.open(encoding="utf-8-sig") as stream:
                header = next((line.strip() for line in stream if not line.startswith("#")), "")
        except (OSError, UnicodeDecodeError):
            return
        yield f"probes: {path.relative_to(folder).as_posix()}     # its header: {header[:60]}"
