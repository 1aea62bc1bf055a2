"""Arrays of which every block has a small file of its own: the ledger."""

import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from wavefield.store.checked import checksum, chunk_path, damaged_block, kept_row, read_chunk, stored_bytes
from wavefield.store.layout import WATCHED, StoreLayout
from wavefield.store.metadata import is_as_completed


def read_blocks(path: Path, group: Any, name: str, layout: StoreLayout) -> np.ndarray:
    """Read the whole of an array of the ledger, file by file: many times as fast as through Zarr.

    Returns (steps,): 0 where nothing is stored.
    """
    array = group[name]
    if array.compressors:  # stores of earlier versions
        return np.asarray(array[:])
    out = np.zeros(array.shape, array.dtype)
    chunks, dtype = array.chunks, array.dtype  # Zarr computes these at every access
    folder = str(chunk_path(path, name, 0).parent)  # many files: plain words are quicker than paths
    for start in range(0, array.shape[-1], layout.block):
        try:
            with open(f"{folder}/{start // layout.block}", "rb", buffering=0) as stream:
                stored = stream.read()
        except FileNotFoundError:
            continue
        values = np.frombuffer(stored, dtype).reshape(chunks)
        part = out[..., start : start + layout.block]
        part[...] = values[..., : part.shape[-1]]
    return out


LEDGER = ("frame_status", "frame_fault")


def check_blocks(path: Path, group: Any, layout: StoreLayout, names: Collection[str] = WATCHED) -> None:
    """Refuse a cube of which a finished block is not as long as it was written, or whose ledger changed."""
    if "stored_bytes" not in group or group["frame_status"].compressors:
        return  # begun before there were such records
    ledger = 0
    missing = 0
    for block in reversed(range(len(layout.blocks()))):
        stored = read_chunk(str(path), "frame_status", block)
        ledger = zlib.crc32(stored, ledger)
        if not any(stored):
            missing = block
            continue
        sizes, checksums = (kept_row(path, name, block) for name in ("stored_bytes", "checksum"))
        for name, row in (("stored_bytes", sizes), ("checksum", checksums)):
            if row is None:
                raise damaged_block(path, name, block, "missing or damaged")
        for name, size, kept in zip(WATCHED, sizes or (), checksums or ()):
            if name not in names:
                continue
            found = stored_bytes(path, name, block)
            if found != size:
                raise damaged_block(path, name, block, "cut off or another" if found else "missing")
            if name in LEDGER and checksum(path, name, block) != kept:
                raise damaged_block(path, name, block, "not as it was written")
    if not is_as_completed(path, ledger):
        raise damaged_block(path, "frame_status", missing, "not as it was when the run ended")


def ledger_checksum(path: Path, layout: StoreLayout) -> int:
    """CRC-32 of the ledger's files, the last block's first."""
    out = 0
    for block in reversed(range(len(layout.blocks()))):
        out = zlib.crc32(read_chunk(str(path), "frame_status", block), out)
    return out
