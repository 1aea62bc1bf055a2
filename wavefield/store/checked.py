"""Reading a cube's files such that no damaged one is taken for what was written."""

import asyncio
import json
import os
import zlib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from zarr.storage import LocalStore

from wavefield.atomic_write import OwnFile, marked, write_text
from wavefield.errors import StoreError
from wavefield.store.metadata import WATCHED
from wavefield.store.store_paths import beside

DAMAGE_NOTE = OwnFile("a list of damaged chunks", marked(start=b'{"damaged blocks begin at steps": ['))
_NUMBER_BYTES = {"checksum": 4, "stored_bytes": 8}


class CheckedStore(LocalStore):
    """The files of a cube for Zarr; each chunk is compared with its checksum when it is first read."""

    def __init__(self, root: Path | str, *, read_only: bool = True) -> None:
        super().__init__(root, read_only=read_only)
        self._intact: set[tuple[str, int, int]] = set()

    async def get(self, key: str, *arguments: Any, **keywords: Any) -> Any:
        """Read a file or a part of it, as every store of Zarr does."""
        await asyncio.to_thread(self._check, key)
        return await super().get(key, *arguments, **keywords)

    def get_sync(self, key: str, **keywords: Any) -> Any:
        """Read a file or a part of it, as every store of Zarr does."""
        self._check(key)
        return super().get_sync(key, **keywords)

    async def get_partial_values(self, prototype: Any, key_ranges: Iterable[Any]) -> Any:
        """Read parts of files, as every store of Zarr does."""
        key_ranges = list(key_ranges)
        for key, _ in key_ranges:
            await asyncio.to_thread(self._check, key)
        return await super().get_partial_values(prototype, key_ranges)

    def _check(self, key: str) -> None:
        name, _, place = key.partition("/c/")
        if not place or name not in WATCHED:
            return
        try:
            state = (self.root / key).stat()
            version = (key, state.st_mtime_ns, state.st_size)
        except OSError:
            version = (key, 0, 0)
        if version in self._intact:
            return
        # "3/0/0" of "z" is chunk 3, "0/3" of "frame_fault" as well
        number = int(place.split("/")[1 if name in ("frame_fault", "camera_shift") else 0])
        expected = description(self.root, "checksum", number)
        if expected is not None:
            found = checksum(self.root, name, number)
            if found != expected[WATCHED.index(name)] and _is_done(self.root, number):
                raise damaged_chunk(self.root, name, number, "not as it was written" if found else "missing")
        self._intact.add(version)


def _is_done(path: Path, number: int) -> bool:
    """Whether the ledger calls steps of a chunk done; until then it may be being written."""
    with suppress(OSError):
        return any(read_chunk(str(path), "frame_status", number) or b"")
    return False


def description(path: Path, kind: str, number: int) -> list[int] | None:
    """Checksums or sizes of a chunk's files when it was written, by `WATCHED`; None where unreadable."""
    content, size = read_chunk(str(path), kind, number), _NUMBER_BYTES[kind]
    if content is None or len(content) != size * len(WATCHED):
        return None
    return [int.from_bytes(content[k : k + size], "little") for k in range(0, len(content), size)]


def checksum(path: Path, name: str, number: int) -> int:
    """CRC-32 of what is stored of one chunk of a variable; 0 where nothing is."""
    content = read_chunk(str(path), name, number)
    return 0 if content is None else zlib.crc32(content) or 1


def stored_bytes(path: Path, name: str, number: int) -> int:
    """Size of what is stored of one chunk of a variable."""
    try:
        return os.stat(f"{path}/{_chunk_name(name, number)}").st_size
    except (FileNotFoundError, NotADirectoryError):
        return 0


def read_chunk(root: str, name: str, number: int) -> bytes | None:
    """All that is stored of one chunk of a variable, None without a file; text is quicker than paths."""
    try:
        with open(f"{root}/{_chunk_name(name, number)}", "rb", buffering=0) as stream:
            return stream.readall()
    except (FileNotFoundError, NotADirectoryError):
        return None


def chunk_path(path: Path, name: str, number: int) -> Path:
    """The file of one chunk of a variable."""
    return path / _chunk_name(name, number)


_PLACES = {
    "frame_fault": "c/0/{}",
    "frame_status": "c/{}",
    "camera_shift": "c/0/{}/0",
    "checksum": "c/{}/0",
    "stored_bytes": "c/{}/0",
}


def _chunk_name(name: str, number: int) -> str:
    return f"{name}/{_PLACES.get(name, 'c/{}/0/0').format(number)}"


def damaged_chunk(path: Path, name: str, number: int, what: str) -> StoreError:
    """The sentence on a damaged chunk; it is noted for the next run, which measures it again."""
    start, stop = number, number + 1
    with suppress(Exception):
        steps = json.loads((path / "zarr.json").read_text(encoding="utf-8"))["attributes"]["steps_per_block"]
        start, stop = number * steps, (number + 1) * steps
        note_damaged(path, {start, *noted_damaged(path)})
    return StoreError(
        f"{chunk_path(path, name, number)} is {what}: {name} of steps {start} to {stop - 1} is lost; "
        "`wavefield run EXPERIMENT` measures these steps again"
    )


def note_damaged(store: Path, starts: Iterable[int]) -> None:
    """Leave for the next run which chunks are damaged, where that can be written."""
    path, listed = beside(store, "damaged", ".json"), sorted(starts)
    with suppress(StoreError, OSError):
        if listed:
            write_text(path, json.dumps({"damaged blocks begin at steps": listed}) + "\n", DAMAGE_NOTE)
        elif path.exists() and not path.is_symlink() and DAMAGE_NOTE.recognize(path):
            path.unlink()


def noted_damaged(store: Path) -> set[int]:
    """First steps of chunks that were found damaged."""
    try:
        data = json.loads(beside(store, "damaged", ".json").read_text(encoding="utf-8"))
        return {int(start) for start in data["damaged blocks begin at steps"]}
    except (OSError, ValueError, TypeError, KeyError):
        return set()
