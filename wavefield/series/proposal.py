"""A lab note proposed from a folder of images, with a comment on every guess."""

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from wavefield.errors import ExperimentError

_ENDINGS = (".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg")
_TARGETS = re.compile(r"calib|target|board|grid|mire|eich", re.IGNORECASE)
_REST = re.compile(r"rest|still|flat_water|repos|ruhe", re.IGNORECASE)
_FEWEST = 3  # images that make a record


@dataclass(frozen=True)
class Numbered:
    """Images whose names differ in one number."""

    pattern: str  # Path from the folder, with ``{frame}`` for the number
    numbers: tuple[int, ...]  # The numbers, in order

    @property
    def step(self) -> int:
        """Usual difference of two numbers."""
        gaps = sorted(b - a for a, b in zip(self.numbers, self.numbers[1:]))
        return gaps[len(gaps) // 2] if gaps else 1


def find_series(folder: Path) -> list[Numbered]:
    """Find the numbered images in a folder and in those below."""
    if not folder.is_dir():
        raise ExperimentError(f"{folder} is no folder; name the one that the images lie in or below")
    found: dict[str, list[int]] = defaultdict(list)
    for path in folder.rglob("*"):
        if path.suffix.lower() in _ENDINGS and path.is_file():
            name = path.relative_to(folder)
            match = re.fullmatch(r"(.*?)(\d+)(\D*)", name.name)
            if match:
                head, digits, tail = match.groups()
                width = f":0{len(digits)}d" if digits.startswith("0") and len(digits) > 1 else ""
                found[(name.parent / f"{head}{{frame{width}}}{tail}").as_posix()].append(int(digits))
    merged = _one_width(found)
    return [Numbered(pattern, tuple(sorted(numbers))) for pattern, numbers in sorted(merged.items())]


def _one_width(found: dict[str, list[int]]) -> dict[str, list[int]]:
    """``img_{frame}`` with the numbers that outgrew ``img_{frame:05d}`` belongs to it."""
    merged = dict(found)
    for pattern in found:
        bare = re.sub(r"\{frame:\d+d\}", "{frame}", pattern)
        if bare != pattern and bare in merged:
            merged[pattern] = merged[pattern] + merged.pop(bare)
    return merged


def propose(folder: str | Path) -> str:
    """Propose an experiment file for a folder of images.

    Parameters
    ----------
    folder : path
        Of the images, with a folder or a beginning of the names for each camera.

    Returns
    -------
    str
        YAML, with a comment on every guess; what nobody can see in a folder is left to be filled in.

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
    records = [s for s in series if not _TARGETS.search(s.pattern) and len(s.numbers) >= _FEWEST]
    rest = [s for s in records if _REST.search(s.pattern)]
    waves = [s for s in records if s not in rest]
    if len(waves) < 2:
        seen = ", ".join(s.pattern for s in series[:4]) or "no numbered images"
        raise ExperimentError(
            f"{folder}: numbered images of two cameras at least are needed, and there are {seen}; name the "
            "folder that all cameras lie below"
        )
    lines = [
        *_head(folder),
        *_cameras(waves),
        *_calibration([s for s in series if _TARGETS.search(s.pattern)]),
        *(_rest(rest)),
        "grid: auto                    # what all cameras see; or {x: [..], y: [..], step: ..} in metres",
        "water: {depth: 0.70}          # TO FILL IN: metres",
        *_probes(folder),
    ]
    return "\n".join(lines) + "\n"


def _head(folder: Path) -> Iterator[str]:
    yield f"# Proposed from the images in {folder.name}; look at every line, then run `wavefield check`."
    yield f"name: {re.sub(r'[^A-Za-z0-9_.-]+', '-', folder.name) or 'experiment'}"
    yield "frame_rate: 20.0              # TO FILL IN: Hz; no image file says it"


def _cameras(records: list[Numbered]) -> Iterator[str]:
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


def _calibration(targets: list[Numbered]) -> Iterator[str]:
    if not targets:
        yield "# calibration: no target images were found; name them here, or a rig: `rig: rig.yaml`"
        return
    yield "calibration:"
    yield "  target: {kind: chessboard, mesh: 0.03, shape: [9, 6]}   # TO FILL IN: mesh in metres"
    names = [re.sub(r"\{frame[^}]*\}", "*", s.pattern) for s in targets]
    general = {re.sub(r"(?i)cam(era)?[_-]?\d+", "{camera}", name) for name in names}
    if len(general) == 1 and "{camera}" in next(iter(general)):
        yield f'  tilted: "{general.pop()}"      # found {", ".join(names)}; the folder names the camera'
    else:
        listed = ", ".join(f'"{name}"' for name in names)
        yield f"  tilted: [{listed}]      # put {{camera}} where a name says the camera"


def _rest(records: list[Numbered]) -> Iterator[str]:
    if not records:
        yield '# rest: "rest/{camera}/img_{frame:05d}.tif"     # images of still, seeded water level the rig'
        return
    patterns = [s.pattern for s in records]
    general = {re.sub(r"(?i)cam(era)?[_-]?\d+", "{camera}", pattern) for pattern in patterns}
    if len(general) == 1 and "{camera}" in next(iter(general)) and _names_fit(patterns):
        yield f'rest: "{general.pop()}"      # water at rest? `wavefield calibrate` levels the rig by it'
        return
    listed = ", ".join(f'cam{k}: "{pattern}"' for k, pattern in enumerate(patterns, 1))
    yield f"rest: {{{listed}}}      # looks like water at rest; is each of its own camera?"


def _names_fit(patterns: list[str]) -> bool:
    """Whether the images themselves call the cameras cam1, cam2 and so on, in order."""
    return all(f"cam{k}" in pattern for k, pattern in enumerate(patterns, 1))


def _probes(folder: Path) -> Iterator[str]:
    tables = sorted(p for p in folder.rglob("*") if p.suffix.lower() in (".csv", ".txt") and p.is_file())
    for path in tables[:1]:
        try:
            with path.open(encoding="utf-8-sig") as stream:
                header = next((line.strip() for line in stream if not line.startswith("#")), "")
        except (OSError, UnicodeDecodeError):
            return
        yield f"probes: {path.relative_to(folder).as_posix()}     # its header: {header[:60]}"
