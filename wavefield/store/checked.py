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

from wavefield.atomic_write import Product, marked, write_text
from wavefield.errors import StoreError
from wavefield.store.layout import WATCHED
from wavefield.store.store_paths import beside

NOTE = Product("a list of damaged blocks", marked(start=b'{"damaged blocks begin at steps": ['))


class CheckedStore(LocalStore):
    """The files of a cube for Zarr; each block is compared with its checksum when it is first read."""

    def __init__(self, root: Path | str, *, read_only: bool = True) -> None:
        super().__init__(root, read_only=read_only)
        self._found_sound: set[tuple[str, int, int]] = set()

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
        block = block_of(name, place)
        file = self.root / key
        try:
            state = file.stat()
            now = (key, state.st_mtime_ns, state.st_size)
        except OSError:
            now = (key, 0, 0)
        if now in self._found_sound:
            return
        requested = kept_row(self.root, "checksum", block)
        if requested is not None and len(requested) > WATCHED.index(name):
            found = checksum(self.root, name, block)
            if found != requested[WATCHED.index(name)] and _is_done(self.root, block):
                raise damaged_block(self.root, name, block, "not as it was written" if found else "missing")
        self._found_sound.add(now)


def block_of(name: str, place: str) -> int:
    """Which block a chunk of a variable is: "3/0/0" of "z" is block 3, "0/3" of "frame_fault" as well."""
    return int(place.split("/")[1 if name in ("frame_fault", "camera_shift") else 0])


def kept_row(path: Path, name: str, block: int) -> list[int] | None:
    """What was kept of a block by "checksum" or "stored_bytes"; None where that cannot be read."""
    content = read_chunk(str(path), name, block)
    size = {"checksum": 4, "stored_bytes": 8}[name]
    if len(content) not in (size * len(WATCHED), size * (len(WATCHED) - 2)):
        return None  # of a version that compressed them, or damaged: opening the cube finds that
    return [int.from_bytes(content[k : k + size], "little") for k in range(0, len(content), size)]


def read_chunk(root: str, name: str, block: int) -> bytes:
    """All that is stored of one block of a variable; many files: plain words are quicker than paths."""
    try:
        with open(f"{root}/{chunk_name(name, block)}", "rb", buffering=0) as stream:
            return stream.readall()
    except (FileNotFoundError, NotADirectoryError):
        return b""


def _is_done(path: Path, block: int) -> bool:
    """Whether the ledger calls steps of a block done; until then it may be being written."""
    with suppress(OSError):
        return any(read_chunk(str(path), "frame_status", block))
    return False


def damaged_block(path: Path, name: str, block: int, what: str) -> StoreError:
    """The sentence on a damaged block; the next run measures it again."""
    start, stop = block, block + 1
    with suppress(Exception):
        steps = json.loads((path / "zarr.json").read_text(encoding="utf-8"))["attributes"]["steps_per_block"]
        start, stop = block * steps, (block + 1) * steps
        note_damaged(path, {start, *noted_damaged(path)})
    return StoreError(
        f"{chunk_path(path, name, block)} is {what}: {name} of steps {start} to {stop - 1} is lost; "
        "`wavefield run EXPERIMENT` measures these steps again"
    )


def note_damaged(store: Path, starts: Iterable[int]) -> None:
    """Leave for the next run which blocks are damaged, where that can be written."""
    path, listed = beside(store, "damaged", ".json"), sorted(starts)
    with suppress(StoreError, OSError):
        if listed:
            write_text(path, json.dumps({"damaged blocks begin at steps": listed}) + "\n", NOTE)
        elif path.exists() and not path.is_symlink() and NOTE.recognize(path):
            path.unlink()


def noted_damaged(store: Path) -> set[int]:
    """First steps of blocks that were found damaged."""
    try:
        data = json.loads(beside(store, "damaged", ".json").read_text(encoding="utf-8"))
        return {int(start) for start in data["damaged blocks begin at steps"]}
    except (OSError, ValueError, TypeError, KeyError):
        return set()


def checksum(path: Path, name: str, block: int) -> int:
    """CRC-32 of what is stored of one block of a variable."""
    content = read_chunk(str(path), name, block)
    return (zlib.crc32(content) or 1) if content or chunk_path(path, name, block).exists() else 0


def stored_bytes(path: Path, name: str, block: int) -> int:
    """Size of what is stored of one block of a variable."""
    try:
        return os.stat(f"{path}/{chunk_name(name, block)}").st_size
    except (FileNotFoundError, NotADirectoryError):
        return 0


def chunk_path(path: Path, name: str, block: int) -> Path:
    """The file of one block of a variable."""
    return path / chunk_name(name, block)


_PLACES = {
    "frame_fault": "c/0/{}",
    "frame_status": "c/{}",
    "camera_shift": "c/0/{}/0",
    "checksum": "c/{}/0",
    "stored_bytes": "c/{}/0",
}


def chunk_name(name: str, block: int) -> str:
    """The file of one block of a variable, relative to the store."""
    return f"{name}/{_PLACES.get(name, 'c/{}/0/0').format(block)}"
