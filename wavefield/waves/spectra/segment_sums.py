"""Sums of powers and products of fields over the segments of a record, averaged over angle: on plain arrays.

Names: ``z`` is the elevation at frame times, half a step before the rest; ``nl`` is (u - U) . grad z and
``rise`` is z_t + U . grad z, with U the mean current: their sum is z_t + u . grad z.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.variables import INSTANTANEOUS
from wavefield.waves.estimation import segment_variance, segments, transfer_functions, wave_kernels
from wavefield.waves.estimation.rings import Rings, half_plane
from wavefield.waves.estimation.welch import Welch

Array = NDArray[Any]

# fields of the cube that each spectral name is made of
SOURCES = {
    "z": ("z", "z_t"),
    "z_t": ("z_t",),
    "rise": ("z", "z_t", "u", "v"),
    "u": ("u",),
    "v": ("v",),
    "w": ("w",),
    "nl": ("z", "z_t", "u", "v"),
}
NAMES = tuple(SOURCES)


@dataclass(frozen=True)
class Requested:
    """Fields and pairs of fields whose powers and products are summed."""

    names: Sequence[str]
    pairs: Sequence[tuple[str, str]] = ()
    planes: Sequence[str] = ()  # fields, or pairs "a*b", that are summed without averaging over angle as well


def sources(names: Sequence[str]) -> list[str]:
    """Fields of the cube that some spectral names need, in the cube's order."""
    needed = {field for name in names for field in SOURCES[name]}
    return [field for field in ("z", "z_t", "u", "v", "w") if field in needed]


class _Advection:
    """(u - U) . grad z, or z_t + U . grad z, of the steps that are cut out: never held for all of them."""

    def __init__(self, fields: Mapping[str, Array], welch: Welch, name: str) -> None:
        self.name = name
        record = welch.record
        # velocities along paths are those at mid-time, as z is; a displacement goes with its frames' mean
        slope = record.dt / 16 if welch.frames == 2 else 0.0
        self.fields = [np.ascontiguousarray(fields[name]) for name in ("z", "z_t", "u", "v")]
        self.shape, self.dtype = self.fields[0].shape, self.fields[0].dtype
        real = self.dtype.type
        for i, mean in enumerate(welch.current, 2):
            velocity = self.fields[i]
            self.fields[i] = velocity - real(mean) if name == "nl" else np.full_like(velocity, mean)
        self.distances = real(slope), real(record.dt / 2), record.dy, record.dx

    def __getitem__(self, steps: slice) -> Array:
        first, end, _ = steps.indices(self.shape[0])
        out = np.empty((end - first, *self.shape[1:]), self.dtype)
        arguments = *self.fields, first, *self.distances, out
        wave_kernels.advection(*arguments)
        if self.name == "rise":
            out += self.fields[1][first:end]
        return out


def transforms(
    fields: dict[str, Array],
    names: Sequence[str],
    welch: Welch,
    memory: Mapping[str, Array] | None = None,
) -> dict[str, Array]:
    """Transforms in space, (cells, steps), of a half segment of fields (steps, ny, nx), which are released.
    z is still at mid-time. ``memory`` are earlier transforms, overwritten.
    """
    out, memory = {}, memory or {}
    advected = [name for name in ("nl", "rise") if name in names]
    for name in advected:
        out[name] = segments.transform_space(_Advection(fields, welch, name), memory.get(name))
    requested = {*names} - {*advected} | ({"z_t"} if "z" in names else set())
    for name in [*fields]:
        block = fields.pop(name)
        if name in requested:
            out[name] = segments.transform_space(block, memory.get(name))
    return out


def sum_segment(
    first: dict[str, Array], second: dict[str, Array], requested: Requested, welch: Welch, begin: int
) -> dict[str, Array]:
    """Sums of one segment from the transforms (cells, n / 2) of its halves; it begins at step ``begin``."""
    sums = empty_sums(first[requested.names[0]], requested, welch.table)
    add_segment(sums, first, second, requested, welch, begin)
    return sums


def empty_sums(half: Array, requested: Requested, table: Rings) -> dict[str, Array]:
    """Zeros for `add_segment`; ``half`` is any half segment's transform, (cells, n / 2)."""
    cells, steps = half.shape
    names = (*requested.names, *(f"{a}*{b}" for a, b in requested.pairs))
    sums = {name: np.zeros((2, table.k.size, steps + 1)) for name in names}
    squares = {f"squares {a}*{b}": np.zeros((table.k.size, steps + 1)) for a, b in requested.pairs}
    planes = {f"map {name}": np.zeros((cells, 2 * steps), half.real.dtype) for name in requested.planes}
    return sums | squares | planes


def add_segment(
    sums: dict[str, Array],
    first: dict[str, Array],
    second: dict[str, Array],
    requested: Requested,
    welch: Welch,
    begin: int,
) -> None:
    """Add the powers and products of a segment, transformed in time, to ``sums``."""
    table, dt, names = welch.table, welch.record.dt, requested.names
    cells, half = first[names[0]].shape
    dtype = first[names[0]].dtype
    transform = segments.TimeTransform(half, dtype, len(names) + 1)
    powers = {name: np.zeros_like(sums[name]) for name in names}  # of this segment alone
    before = {f"{a}*{b}": sums[f"{a}*{b}"].copy() for a, b in requested.pairs if "nl" in (a, b)}
    omega = 2 * np.pi * np.fft.fftfreq(2 * half, dt)  # signed
    to_frame_time = transfer_functions.to_frame_time(omega, dt, welch.frames, welch.z_frames).astype(dtype)
    k = half_plane(*welch.record.shape, welch.record.dy, welch.record.dx)
    quadrature = [factor.astype(first[names[0]].real.dtype) for factor in _quadrature(omega * dt / 2)]
    for slab in segments.slabs(cells):
        start = table.start[slab.start : slab.stop + 1]
        lines = {}
        for i, name in enumerate(names):
            halves = first[name][slab], second[name][slab]
            if name == "z" and welch.frames == 2:
                halves = _at_frame_times(first, second, slab, dt)
            lines[name] = transform(*halves, i)
            if name == "z" and welch.frames == INSTANTANEOUS:
                lines[name] *= np.exp(-0.5j * omega * dt).astype(dtype)
            elif name == "z" and welch.moving:
                lines[name] *= transfer_functions.from_moving_frame(k[slab, None], omega, dt)
            elif name == "z" and welch.frames != 2:
                lines[name] += to_frame_time * transform(first["z_t"][slab], second["z_t"][slab], len(names))
            wave_kernels.ring_powers(lines[name], start, table.ring, table.weight, table.spread, powers[name])
            if name in requested.planes:
                wave_kernels.add_powers(lines[name], sums[f"map {name}"][slab])
        for a, b in requested.pairs:
            pair = f"{a}*{b}"
            wave_kernels.ring_cross_spectra(lines[a], lines[b], start, table.ring, table.weight, sums[pair])
            squares = sums[f"squares {pair}"]
            wave_kernels.ring_squares(lines[a], lines[b], start, table.ring, table.spread, squares)
            if pair in requested.planes:
                plane = sums[f"map {pair}"][slab]
                wave_kernels.add_products(lines[a], lines[b], quadrature[0], quadrature[1], plane)
    for name in names:
        segment_variance.take_in(sums, name, powers[name], begin)
    for pair, earlier in before.items():
        segment_variance.keep_product(sums, pair, sums[pair] - earlier, begin)


def _quadrature(b: Array) -> tuple[Array, Array]:
    """Factors of real and imaginary part of a product, in numpy's signs; `b` is omega dt / 2, signed."""
    imaginary = np.where(b < 0, -1.0, 1.0) * np.cos(b)
    imaginary[[0, b.size // 2]] = 0.0
    return -np.sin(np.abs(b)), imaginary


def _at_frame_times(
    first: Mapping[str, Array], second: Mapping[str, Array], slab: slice, dt: float
) -> tuple[Array, Array]:
    """z of both halves of a segment at frame times, exactly: z and the differences z_t hold the frames."""
    dtype, steps = first["z"].dtype, first["z"].shape[1]
    real = dtype.type(0).real.dtype
    halves = [part[name].T.view(real) for name in ("z", "z_t") for part in (first, second)]
    starts = [np.empty((steps, slab.stop - slab.start), dtype) for _ in range(2)]
    arguments = *halves, real.type(dt), 2 * slab.start, *(part.view(real) for part in starts)
    wave_kernels.frames(*arguments)
    return starts[0].T, starts[1].T
