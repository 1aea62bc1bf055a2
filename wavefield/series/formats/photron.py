"""Read recordings of Photron: pixels in `.mraw`, their format in `.cihx` (XML) or `.cih` (text)."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from wavefield.errors import FrameError
from wavefield.series.formats.recording import (
    RawRecording,
    Recording,
    checked_shape,
    complete_images,
    pixels,
)

_NEEDED = ("Total Frame", "Image Width", "Image Height", "Color Bit")
_XML = {
    "Total Frame": "frameInfo/totalFrame",
    "Image Width": "imageDataInfo/resolution/width",
    "Image Height": "imageDataInfo/resolution/height",
    "Color Bit": "imageDataInfo/colorInfo/bit",
    "Record Rate(fps)": "recordInfo/recordRate",
}


def open_photron(path: Path) -> Recording:
    """Open a recording of a Photron camera by the path of its .mraw, .cihx or .cih file.
    FrameError if the pixels (.mraw) or the header are missing or damaged, or if the images are not grey."""
    note = _with_ending(path, ".cihx", ".cih", ".CIHX", ".CIH")
    if note is None:
        raise FrameError(f"{path} has no .cihx or .cih next to it, which states how large its images are")
    raw = _with_ending(path, ".mraw", ".MRAW")
    if raw is None:
        raise FrameError(f"{path} has no .mraw next to it: save the recording as MRAW")
    stated = _read_xml(note) if note.suffix.lower() == ".cihx" else _read_text(note)
    missing = [name for name in _NEEDED if name not in stated]
    if missing:
        raise FrameError(f"{note} does not state {', '.join(missing)}: it is damaged")
    try:
        count, width, height, bits = (int(stated[name]) for name in _NEEDED)
        rate = float(stated.get("Record Rate(fps)") or 0) or None
    except ValueError:
        raise FrameError(f"{note} states sizes or a rate that are not numbers: it is damaged") from None
    shape = checked_shape(note, width, height)
    if bits not in (8, 10, 12, 16):
        raise FrameError(f"{note}: images of {bits} bits a pixel are not read; save them in grey")
    take, each = pixels(shape, bits)

    def start(index: int) -> int:
        return index * each

    complete = complete_images(raw, count, start, each)
    return RawRecording(raw, complete, shape, start, take, rate)


def _with_ending(path: Path, *endings: str) -> Path | None:
    """Return `path` with the first of `endings` for which such a file exists; None if there is none."""
    return next((file for file in map(path.with_suffix, endings) if file.is_file()), None)


def _read_text(path: Path) -> dict[str, str]:
    """Return the entries of a .cih file by name, from its lines `name : value`."""
    out = {}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        name, colon, value = line.partition(":")
        if colon:
            out[name.strip()] = value.strip()
    return out


def _read_xml(path: Path) -> dict[str, str]:
    """Return the entries of a .cihx file as text, by the names that a .cih file uses."""
    data = path.read_bytes()
    xml = re.search(rb"<cih>.*</cih>", data, re.DOTALL)
    if not xml:
        raise FrameError(f"{path} holds no <cih>: it is damaged or truncated")
    try:
        root = ET.fromstring(xml[0])
    except ET.ParseError as error:
        raise FrameError(f"{path} is damaged: {error}") from None
    return {name: text for name, place in _XML.items() if (text := root.findtext(place))}
