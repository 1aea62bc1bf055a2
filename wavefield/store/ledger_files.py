"""The ledger: arrays of which every chunk of steps has a small, uncompressed file of its own."""

import zlib
from collections.abc import Collection
from pathlib import Path

import numpy as np

from wavefield.store.checked import checksum, damaged_chunk, description, read_chunk, stored_bytes
from wavefield.store.cube_group import CubeGroup
from wavefield.store.layout import StoreLayout
from wavefield.store.metadata import DESCRIPTIONS, WATCHED, completed_ledger, differs_from_completed

LEDGER = ("frame_status", "frame_fault")


def read_ledger(path: Path, group: CubeGroup, name: str, layout: StoreLayout) -> np.ndarray:
    """An array of the ledger, file by file: many times as fast as through Zarr; 0 where nothing is stored."""
    array = group[name]
    if array.compressors:  # of version 0.1.0
        return np.asarray(array[:])
    out = np.zeros(array.shape, array.dtype)
    chunks, dtype = array.chunks, array.dtype  # Zarr computes these at every access
    for number in range(-(-array.shape[-1] // layout.chunk_steps)):
        stored = read_chunk(str(path), name, number)
        if stored is not None:
            part = out[..., number * layout.chunk_steps : (number + 1) * layout.chunk_steps]
            part[...] = np.frombuffer(stored, dtype).reshape(chunks)[..., : part.shape[-1]]
    return out


def check_chunks(path: Path, group: CubeGroup, layout: StoreLayout, names: Collection[str] = WATCHED) -> None:
    """Refuse a cube whose ledger changed or of which a finished chunk has another length than it had."""
    if DESCRIPTIONS[1] not in group:
        return  # of version 0.1.0
    kept, ledger, missing = completed_ledger(path), 0, 0
    for number in reversed(range(len(layout.chunks()))):
        stored = read_chunk(str(path), "frame_status", number) or b""
        ledger = zlib.crc32(stored, ledger)
        if not any(stored):
            missing = number
            continue
        checksums, sizes = (description(path, kind, number) for kind in DESCRIPTIONS)
        for kind, row in zip(DESCRIPTIONS, (checksums, sizes)):
            if row is None:
                raise damaged_chunk(path, kind, number, "missing or damaged")
        for name, expected_sum, expected_size in zip(WATCHED, checksums or (), sizes or ()):
            if name not in names:
                continue
            size = stored_bytes(path, name, number)
            if size != expected_size:
                raise damaged_chunk(path, name, number, "cut off or another" if size else "missing")
            if name in LEDGER and checksum(path, name, number) != expected_sum:
                raise damaged_chunk(path, name, number, "not as it was written")
    if differs_from_completed(path, kept, ledger):
        raise damaged_chunk(path, "frame_status", missing, "not as it was when the run ended")


def ledger_checksum(path: Path, layout: StoreLayout) -> int:
    """CRC-32 of the ledger's files, the last one first."""
    out = 0
    for number in reversed(range(len(layout.chunks()))):
        out = zlib.crc32(read_chunk(str(path), "frame_status", number) or b"", out)
    return out
