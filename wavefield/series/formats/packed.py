"""Pixels of 10 or 12 bits one after another in a file."""

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numba as nb
import numpy as np
from llvmlite import ir
from numba import int64, types, uint8, uint16, void
from numba.core.base import BaseContext
from numba.core.typing.templates import Signature

from wavefield.compiled import compiled
from wavefield.series.formats.recording import Pixels, Stream, fill

LANES = 8  # pixels that are unpacked together: of 10 or 12 bits they begin and end with a byte
LOADED_BYTES = 16  # bytes that are loaded for them, more than they fill


def packed(shape: tuple[int, int], bits: int) -> Callable[[Stream], Pixels]:
    """Reader of pixels of 10 or 12 bits one after another, the highest bit first."""
    together = {10: _unpack_10, 12: _unpack_12}[bits] if sys.byteorder == "little" else None
    size = packed_bytes(shape, bits)

    def take(stream: Stream) -> Pixels:
        out = np.empty(shape, np.uint16)
        flat = out.reshape(-1)
        # to the end of the image's own memory, unpacked to its beginning: writing never overtakes reading
        raw = flat.view(np.uint8)[2 * flat.size - size :]
        fill(raw, stream)
        done = together(raw, flat) if together else 0
        _unpack_plainly(raw, bits, done, flat)
        return out

    return take


def packed_bytes(shape: tuple[int, int], bits: int) -> int:
    """Bytes of an image of packed pixels."""
    return -(-shape[0] * shape[1] * bits // 8)


def _together(bits: int) -> Any:
    """Unpack eight pixels at once, from element `place` of the bytes to element `to` of the pixels.
    Plain loops take three to six times as long: LLVM does not use the one instruction that gathers bytes.
    """

    def eight(
        _: object, raw: types.Array, place: types.Integer, out: types.Array, to: types.Integer
    ) -> tuple[Any, Any]:
        octets, words = ir.VectorType(ir.IntType(8), LOADED_BYTES), ir.VectorType(ir.IntType(16), LANES)
        first = [k * bits // 8 for k in range(LANES)]
        shifts = [16 - bits - k * bits % 8 for k in range(LANES)]

        def build(
            context: BaseContext, builder: ir.IRBuilder, signature: Signature, arguments: Sequence[ir.Value]
        ) -> Any:
            source, target = (
                context.make_array(signature.args[n])(context, builder, arguments[n]).data for n in (0, 2)
            )
            value = builder.load(builder.bitcast(builder.gep(source, [arguments[1]]), octets.as_pointer()))
            value.align = 1
            order = [byte for f in first for byte in (f + 1, f)]
            order = ir.Constant(ir.VectorType(ir.IntType(32), LOADED_BYTES), order)
            value = builder.shuffle_vector(value, ir.Constant(octets, ir.Undefined), order)
            value = builder.lshr(builder.bitcast(value, words), ir.Constant(words, shifts))
            value = builder.and_(value, ir.Constant(words, [2**bits - 1] * LANES))
            stored = builder.store(
                value, builder.bitcast(builder.gep(target, [arguments[3]]), words.as_pointer())
            )
            stored.align = 2
            return context.get_dummy_value()

        index = types.intp
        return types.void(raw, index, out, index), build

    return nb.extending.intrinsic(eight)


_eight_of_10: Any = _together(10)
_eight_of_12: Any = _together(12)


@compiled([int64(uint8[::1], uint16[::1])])
def _unpack_10(raw: Pixels, out: Pixels) -> int:
    """Unpack from the first pixel on; returns how many: loads must not pass the end of the bytes."""
    times = min(len(out) // LANES, max(0, (len(raw) - LOADED_BYTES) // 10 + 1))
    for k in range(times):
        _eight_of_10(raw, 10 * k, out, LANES * k)
    return LANES * times


@compiled([int64(uint8[::1], uint16[::1])])
def _unpack_12(raw: Pixels, out: Pixels) -> int:
    """As `_unpack_10`."""
    times = min(len(out) // LANES, max(0, (len(raw) - LOADED_BYTES) // 12 + 1))
    for k in range(times):
        _eight_of_12(raw, 12 * k, out, LANES * k)
    return LANES * times


@compiled([void(uint8[::1], int64, int64, uint16[::1])], error_model="numpy")
def _unpack_plainly(raw: Pixels, bits: int, first: int, out: Pixels) -> None:
    """Pixels from ``first`` on, bit by bit."""
    for o in range(first, len(out)):
        value = 0
        for bit in range(o * bits, (o + 1) * bits):
            value = 2 * value + ((raw[bit >> 3] >> (7 - (bit & 7))) & 1)
        out[o] = value
