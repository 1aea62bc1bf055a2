"""A copy of a cube's small files, by which damage of its metadata and coordinates is found and undone.

What a run writes chunk by chunk has a checksum for each chunk. Everything else in a cube (metadata,
coordinates, the table of the gain) is small, and is kept a second time in ``checksum/metadata.zip``.
"""

import time
import zipfile
from pathlib import Path

from wavefield.atomic_write import ANY_FILE, atomic, file_names, make_durable
from wavefield.errors import StoreError
from wavefield.variables import CUBE_FIELDS

ARCHIVE = "checksum/metadata.zip"
SETTLING_SECONDS = 5.0  # in which a run at work, which has changed small files, writes their copies
_COMPLETE = "checksum/complete"  # checksum of the ledger of a run that has ended

# variables whose chunks have a checksum; those after frame_fault since the ledger has one
WATCHED: tuple[str, ...] = (*CUBE_FIELDS, "frame_fault", "camera_shift", "frame_status")
DESCRIPTIONS = ("checksum", "stored_bytes")  # arrays that describe the files of every chunk of steps


def keep_metadata(path: Path) -> None:
    """Keep a copy of all small files of a cube, after they were written or changed on purpose."""
    names = [name for name in file_names(path) if _is_small(name)]
    make_durable([path / name for name in names])
    with (
        atomic(path / ARCHIVE, ANY_FILE) as draft,
        zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for name in names:
            archive.writestr(zipfile.ZipInfo(name), (path / name).read_bytes(), zipfile.ZIP_DEFLATED)


def _is_small(name: str) -> bool:
    array, _, rest = name.partition("/")
    of_chunk = array in (*WATCHED, *DESCRIPTIONS) and rest.startswith("c/")
    return name not in (ARCHIVE, _COMPLETE) and not of_chunk


def check_metadata(path: Path) -> None:
    """Compare a cube's small files with their copies, which a run at work writes shortly after them."""
    until = time.monotonic() + SETTLING_SECONDS
    while name := _changed_file(path):
        if is_complete(path) or time.monotonic() > until:
            what = "not as it was written" if (path / name).exists() else "missing"
            raise StoreError(
                f"{path / name} is {what}: without it the cube would be read wrongly; "
                "`wavefield run EXPERIMENT` puts it back"
            )
        time.sleep(0.1)


def _changed_file(path: Path) -> str | None:
    """The first small file of a cube that differs from its copy, if any."""
    return next((name for name, content in _kept(path).items() if _read(path / name) != content), None)


def restore_metadata(path: Path) -> list[str]:
    """Put a cube's small files back as they were written."""
    try:
        kept = _kept(path)
    except StoreError:  # the copies are made anew from the files, which a run compares with its recipe
        (path / ARCHIVE).unlink(missing_ok=True)
        return [ARCHIVE]
    damaged = [name for name, content in kept.items() if _read(path / name) != content]
    for name in damaged:
        with atomic(path / name, ANY_FILE) as draft:
            draft.write_bytes(kept[name])
    return damaged


def _kept(path: Path) -> dict[str, bytes]:
    """Contents of the small files by name; empty in cubes from before there were copies."""
    if not (path / ARCHIVE).is_file():
        return {}
    try:
        with zipfile.ZipFile(path / ARCHIVE) as archive:
            return {name: archive.read(name) for name in archive.namelist() if ".." not in name}
    except Exception as error:  # whatever comes of damaged bytes
        raise StoreError(
            f"{path / ARCHIVE} is damaged ({error}): whether the cube's metadata are as they were written "
            "cannot be checked; `wavefield run EXPERIMENT` writes it again"
        ) from None


def _read(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def mark_complete(path: Path, ledger_checksum: int | None) -> None:
    """Keep the checksum of the ledger when a run has ended; None while one is at work."""
    mark = path / _COMPLETE
    if ledger_checksum is None:
        mark.unlink(missing_ok=True)
    elif _read(mark) != str(ledger_checksum).encode():
        with atomic(mark, ANY_FILE) as draft:
            draft.write_text(str(ledger_checksum))


def is_complete(path: Path) -> bool:
    """Whether the run that writes a cube has ended."""
    return (path / _COMPLETE).exists()


def completed_ledger(path: Path) -> bytes | None:
    """What `mark_complete` kept of the ledger of the run that has ended, if one has."""
    return _read(path / _COMPLETE)


def differs_from_completed(path: Path, kept: bytes | None, ledger_checksum: int) -> bool:
    """Whether a ledger is not that of the run that has ended, by what was kept before the ledger was read."""
    # a run that began or ended meanwhile has removed or written the mark
    return kept not in (None, str(ledger_checksum).encode()) and kept == completed_ledger(path)
