"""Whether the coded pixels of a JPEG file can be those that were written: decoders guess at damaged ones.

The Huffman codes of a baseline JPEG (ITU-T T.81) are followed to their end. Damage shifts them, so that codes
that do not exist, coefficients beyond their range or a wrong number of blocks follow. Progressive files are
not followed.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavefield.compiled import compiled

_SEQUENTIAL = (0xC0, 0xC1)
_RESTART, _END_OF_IMAGE, _MARK = 0xD0, 0xD9, 0xFF
_MAX_MEAN_BITS, _MAX_DETAIL_BITS, _SIXTEEN_ZEROS = 11, 10, 0xF0
_MAX_MEAN = 1024  # of eight times the mean of a block's 8 bits, less 128
_HUFFMAN, _QUANTIZATION, _RESTART_INTERVAL, _START_OF_SCAN = 0xC4, 0xDB, 0xDD, 0xDA


class _Component(NamedTuple):
    across: int  # blocks of one unit
    down: int
    quantization: int  # number of its table


class _Headers:
    """Tables and sizes of a file, and where its coded pixels begin."""

    def __init__(self, data: bytes) -> None:
        self.quantizer = dict[int, int]()  # of the mean of a block
        self.tables = dict[int, NDArray[np.uint16]]()
        self.components = dict[int, _Component]()
        self.size, self.interval, self.start = (0, 0), 0, 0
        self.sequential, self.scan = False, list[tuple[int, int, int]]()
        place = 2
        while not self.start:
            if data[place] != 0xFF:
                raise ValueError("no marker where one should be")
            marker = data[place + 1]
            if marker == 0xFF:  # fill
                place += 1
                continue
            length = int.from_bytes(data[place + 2 : place + 4], "big")
            self._read(marker, data[place + 4 : place + 2 + length])
            place += 2 + length
            if marker == _START_OF_SCAN:
                self.start = place

    def _read(self, marker: int, part: bytes) -> None:
        if marker in _SEQUENTIAL:
            self.sequential = part[0] == 8
            self.size = int.from_bytes(part[3:5], "big"), int.from_bytes(part[1:3], "big")
            for k in range(part[5]):
                name, sampling, table = part[6 + 3 * k : 9 + 3 * k]
                self.components[name] = _Component(sampling >> 4, sampling & 15, table)
        elif marker == _HUFFMAN:
            while part:
                count = sum(part[1:17])
                self.tables[part[0]] = _lookup(part[1:17], part[17 : 17 + count])
                part = part[17 + count :]
        elif marker == _QUANTIZATION:
            while part:
                width = 1 + (part[0] >> 4)
                self.quantizer[part[0] & 15] = int.from_bytes(part[1 : 1 + width], "big")
                part = part[1 + 64 * width :]
        elif marker == _RESTART_INTERVAL:
            self.interval = int.from_bytes(part[:2], "big")
        elif marker == _START_OF_SCAN:
            self.scan = [
                (part[1 + 2 * k], part[2 + 2 * k] >> 4, part[2 + 2 * k] & 15) for k in range(part[0])
            ]


def _lookup(counts: bytes, symbols: bytes) -> NDArray[np.uint16]:
    """256 times the length of the code that any 16 bits begin with, and its symbol; 0 where there is none."""
    out, code, used = np.zeros(65536, np.uint16), 0, 0
    for length, count in enumerate(counts, 1):
        for symbol in symbols[used : used + count]:
            out[code << (16 - length) : (code + 1) << (16 - length)] = length << 8 | symbol
            code += 1
        used, code = used + count, code << 1
    return out


def is_damaged(data: bytes) -> bool:
    """Whether the codes of a JPEG file do not end where they should.
    False of what is not followed: progressive files, several scans, tables kept elsewhere.
    """
    try:
        head = _Headers(data)
        followed = head.sequential and min(head.size) > 0 and len(head.tables) > 0
        if not followed or len(head.scan) != len(head.components):
            return False  # progressive, in several scans, or with the tables of a film
        parts = [head.components[name] for name, _, _ in head.scan]
        if len(parts) == 1:  # then every block is a unit
            parts = [_Component(1, 1, parts[0].quantization)]
        across, down = max(p.across for p in parts), max(p.down for p in parts)
        units = -(-head.size[0] // (8 * across)) * -(-head.size[1] // (8 * down))
        order = np.repeat(np.arange(len(parts)), [p.across * p.down for p in parts])
        means = np.stack([head.tables[mean] for _, mean, _ in head.scan])
        details = np.stack([head.tables[16 + detail] for _, _, detail in head.scan])
        steps = np.array([head.quantizer[p.quantization] for p in parts])
    except (IndexError, KeyError, ValueError):
        return True  # its headers are damaged
    coded = np.frombuffer(data, np.uint8)[head.start :]
    return not _follow(coded, units, head.interval or units, order, means, details, steps)


@compiled()
def _next_marker(coded: NDArray[np.uint8], place: int) -> int:
    """Place of the marker that follows, past fill bytes (0 or 255); -1 if anything else is there."""
    last = len(coded) - 1
    while place < last:
        if coded[place] == _MARK and coded[place + 1] not in (0, _MARK):
            return place
        if coded[place] not in (0, _MARK):
            return -1
        place += 1
    return -1


@compiled()
def _next_code(
    coded: NDArray[np.uint8], state: NDArray[np.int64], table: NDArray[np.uint16]
) -> tuple[int, int]:
    """Next symbol and the number behind it; -1 where there is no such code. State: place, bits held, bits."""
    place, count, bits = state
    while count < 32 and place + 1 < len(coded) and not (coded[place] == _MARK and coded[place + 1] != 0):
        bits = ((bits & 0xFFFFFFFF) << 8) | coded[place]
        place += 2 if coded[place] == _MARK else 1
        count += 8
    window = (bits >> (count - 16) if count >= 16 else bits << (16 - count)) & 0xFFFF
    length, symbol = table[window] >> 8, table[window] & 255
    size = symbol & 15
    if length == 0 or length + size > count:
        return -1, 0
    count -= length + size
    state[0], state[1], state[2] = place, count, bits
    value = (bits >> count) & ((1 << size) - 1)
    return symbol, value if size == 0 or value >> (size - 1) else value - (1 << size) + 1


@compiled()
def _follow_block(
    coded: NDArray[np.uint8], state: NDArray[np.int64], means: NDArray[np.uint16], details: NDArray[np.uint16]
) -> tuple[bool, int]:
    """Follow the codes of a block; whether they can be, and by how much its mean differs from the last."""
    symbol, change = _next_code(coded, state, means)
    if symbol < 0 or symbol > _MAX_MEAN_BITS:
        return False, 0
    k = 1
    while k < 64:
        symbol, _ = _next_code(coded, state, details)
        if symbol == 0:  # the rest is zero
            break
        size = symbol & 15
        if symbol < 0 or size > _MAX_DETAIL_BITS or (size == 0 and symbol != _SIXTEEN_ZEROS):
            return False, 0
        k += (symbol >> 4) + 1
    return k <= 64, change


@compiled()
def _follow(
    coded: NDArray[np.uint8],
    units: int,
    interval: int,
    order: NDArray[np.int64],
    means: NDArray[np.uint16],
    details: NDArray[np.uint16],
    steps: NDArray[np.int64],
) -> bool:
    """Follow all codes; whether they end with the image."""
    state = np.zeros(3, np.int64)
    mean = np.zeros(len(steps), np.int64)
    for unit in range(units):
        if unit and unit % interval == 0:
            place = _next_marker(coded, state[0])
            if state[1] >= 8 or place < 0 or coded[place + 1] != _RESTART + (unit // interval - 1) % 8:
                return False
            state[:] = (place + 2, 0, 0)
            mean[:] = 0
        for part in order:
            valid, change = _follow_block(coded, state, means[part], details[part])
            mean[part] += change
            if not valid or abs(2 * mean[part] * steps[part]) > 2 * _MAX_MEAN + steps[part]:
                return False
    place = _next_marker(coded, state[0])
    return state[1] < 8 and place >= 0 and coded[place + 1] == _END_OF_IMAGE
