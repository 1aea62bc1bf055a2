"""Read and write the metadata of a cube: ``zarr.json``, with a checksum that shows changes and damage."""

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from wavefield.atomic_write import atomic, writing
from wavefield.errors import StoreError
from wavefield.text import one_line

CHECKSUM = "metadata_checksum"  # attribute: CRC-32 of the rest of zarr.json
FINISHED = "finished"  # attribute: true once the run has ended


def read_metadata(path: Path) -> dict[str, Any]:
    """Return the content of a cube's ``zarr.json``.
    StoreError if the file is missing, damaged, changed since wavefield wrote it, or not that of a cube."""
    file = path / "zarr.json"
    if not path.exists():
        raise StoreError(f"{path}: no such store; make one with `wavefield run`")
    if not file.exists():
        raise StoreError(
            f"{path} is not a cube, or a damaged copy: it has no zarr.json; "
            "copy the cube again, or choose another name"
        )
    try:
        data: dict[str, Any] = json.loads(file.read_bytes())
        attributes = data["attributes"]
    except Exception as error:  # damaged bytes raise errors of many kinds
        raise StoreError(f"{file} cannot be read ({one_line(error)[:200]}); copy the cube again") from None
    if not isinstance(attributes, dict) or "recipe" not in attributes:
        raise StoreError(f"{path} is not a cube of `wavefield run`; choose another name")
    if attributes.get(CHECKSUM) != _checksum(data):
        raise StoreError(f"{file} was changed since it was written, or is damaged; copy the cube again")
    return data


def update_metadata(path: Path, attributes: Mapping[str, object]) -> None:
    """Set attributes of the cube at `path`; an attribute with the value None is removed."""
    data = read_metadata(path)
    merged = {**data["attributes"], **attributes}
    data["attributes"] = {name: value for name, value in merged.items() if value is not None}
    with writing(path):
        write_metadata(path, data)


def write_metadata(path: Path, data: dict[str, Any]) -> None:
    """Write `data` as ``zarr.json`` with its checksum, completely or not at all; `data` is changed."""
    data["attributes"][CHECKSUM] = _checksum(data)
    with atomic(path / "zarr.json", replace=True) as draft:
        draft.write_text(json.dumps(data, indent=1), encoding="utf-8")


def _checksum(data: Mapping[str, Any]) -> int:
    """Return the CRC-32 of the content of ``zarr.json``, without the attribute that holds a checksum."""
    attributes = {name: value for name, value in data["attributes"].items() if name != CHECKSUM}
    return zlib.crc32(json.dumps({**data, "attributes": attributes}, sort_keys=True).encode())
