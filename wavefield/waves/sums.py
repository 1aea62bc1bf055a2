"""Sums over Welch segments of the powers and cross products of fields, from which all spectra are made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.water import dispersion
from wavefield.waves import kernels
from wavefield.waves.dof import keep_points
from wavefield.waves.rings import Rings, half_plane
from wavefield.waves.welch import (
    CELLS,
    Link,
    TimeTransform,
    Welch,
    slabs,
    some_nodes,
    sum_segments,
    transform_space,
)

Array = NDArray[Any]

MIN_AMPLITUDE = 0.5  # smallest gain that is corrected (chosen): a correction at most doubles the amplitude

NAMES = ("z", "z_t", "rise", "u", "v", "w", "nl")  # nl is (u - U) . grad z, and rise is z_t + U . grad z
ADVECTED = ("z", "z_t", "u", "v")  # fields of the cube from which rise and nl are computed


@dataclass(frozen=True)
class Requested:
    """Quantities whose powers are summed over segments, and pairs whose cross products are summed."""

    names: Sequence[str]
    pairs: Sequence[tuple[str, str]] = ()
    planes: Sequence[str] = ()  # quantities, or pairs "a*b", that are also summed at each cell of the k plane
    nodes: bool = False  # whether powers of a single quantity are also summed over all nodes


def sources(names: Sequence[str]) -> list[str]:
    """Return the variables of a cube from which the quantities `names` are computed."""
    fields = [ADVECTED if name in ("rise", "nl") else (name,) for name in names]
    return list(dict.fromkeys(field for of_name in fields for field in of_name))


def advected(fields: Mapping[str, Array], welch: Welch) -> dict[str, Array]:
    """Return nl = (u - U) . grad z and rise = z_t + U . grad z by name, (steps, ny, nx); U is the current."""
    z, z_t, u, v = (fields[name] for name in ADVECTED)
    z_y, z_x = np.empty_like(z), np.empty_like(z)
    kernels.gradient(z, welch.record.dy, welch.record.dx, z_y, z_x)
    along_x, along_y = map(z.dtype.type, welch.current)
    nl, across = u - along_x, v - along_y
    nl *= z_x  # in place, because new arrays of half a segment cost more than the products
    across *= z_y
    nl += across
    z_x *= along_x
    z_y *= along_y
    z_x += z_y
    z_x += z_t
    return {"nl": nl, "rise": z_x}


def transforms(
    fields: dict[str, Array], requested: Requested, welch: Welch, memory: Mapping[str, Array] | None = None
) -> dict[str, Array]:
    """Return arrays for half a segment by name: "<name>" (cells, steps), spatial Fourier transforms; "points
    <name>" (16, steps), values at 16 nodes; "nodes" (pairs, steps), values at all nodes, two in a complex
    number. To save memory, `fields` is emptied and `memory` is overwritten."""
    out, memory, names = {}, memory or {}, requested.names
    if {"nl", "rise"} & {*names}:
        fields |= advected(fields, welch)
    for name in [*fields]:
        block = fields.pop(name)
        if name in names:
            out[f"points {name}"] = some_nodes(block)
            if requested.nodes:
                flat = block.reshape(len(block), -1)
                pairs = np.ascontiguousarray(flat[:, : flat.shape[1] // 2 * 2])  # an odd node is left out
                out["nodes"] = pairs.view(np.result_type(pairs.dtype, np.complex64)).T
            out[name] = transform_space(block, memory.get(name))
    return out


def empty_sums(half: Array, requested: Requested, table: Rings) -> dict[str, Array]:
    """Return arrays of zeros, by name, to which `add_segment` adds. "<name>" is for power and squared power,
    "a*b" for real and imaginary part, both (2, rings, n / 2 + 1). "squares a*b" is (rings, n / 2 + 1), and
    "map ..." (cells, n), where `half` is (cells, n / 2)."""
    cells, steps = half.shape
    names = (*requested.names, *(f"{a}*{b}" for a, b in requested.pairs))
    sums = {name: np.zeros((2, table.k.size, steps + 1)) for name in names}
    squares = {f"squares {a}*{b}": np.zeros((table.k.size, steps + 1)) for a, b in requested.pairs}
    planes = {f"map {name}": np.zeros((cells, 2 * steps), half.real.dtype) for name in requested.planes}
    return sums | squares | planes


def add_segment(
    requested: Requested,
    welch: Welch,
    sums: dict[str, Array],
    first: dict[str, Array],
    second: dict[str, Array],
    begin: int,
) -> None:
    """Add the powers and cross products of one segment to `sums`. Also store in `sums` the Fourier transforms
    of time series at 16 nodes, for degrees of freedom. `first` and `second` are `transforms` of the two
    halves of the segment, and `begin` is the first step of the segment."""
    if not sums:
        sums |= empty_sums(first[requested.names[0]], requested, welch.table)
    table, dt, names = welch.table, welch.record.dt, requested.names
    cells, half = first[names[0]].shape
    dtype = first[names[0]].dtype
    transform = TimeTransform(half, dtype, len(names))
    omega = 2 * np.pi * np.fft.fftfreq(2 * half, dt)  # signed
    k = half_plane(*welch.record.shape, welch.record.dy, welch.record.dx)
    quadrature = [factor.astype(first[names[0]].real.dtype) for factor in _quadrature(omega * dt / 2)]
    for slab in slabs(cells):
        start = table.start[slab.start : slab.stop + 1]
        lines = {}
        for i, name in enumerate(names):
            lines[name] = transform(first[name][slab], second[name][slab], i)
            if name == "z":
                lines[name] *= to_frame_time(k[slab, None], omega, dt, welch.frames)
            kernels.ring_powers(lines[name], start, table.ring, table.weight, table.spread, sums[name])
            if name in requested.planes:
                kernels.add_powers(lines[name], sums[f"map {name}"][slab])
        for pair in requested.pairs:
            one, other, name = lines[pair[0]], lines[pair[1]], "*".join(pair)
            kernels.ring_cross_spectra(one, other, start, table.ring, table.weight, sums[name])
            kernels.ring_squares(one, other, start, table.ring, table.spread, sums[f"squares {name}"])
            if f"map {name}" in sums:
                kernels.add_products(one, other, quadrature[0], quadrature[1], sums[f"map {name}"][slab])
    for name in names:
        keep_points(sums, name, first[f"points {name}"], second[f"points {name}"], begin)
    if requested.nodes:
        sums["nodes"] = sums.get("nodes", 0) + _powers_of_nodes(first["nodes"], second["nodes"])


def _powers_of_nodes(first: Array, second: Array) -> Array:
    """Return the power of a segment summed over nodes, (n // 2 + 1,), from halves (pairs of nodes, steps)."""
    half = first.shape[1]
    transform, sums = TimeTransform(half, first.dtype), np.zeros((CELLS, 2 * half))
    for slab in slabs(first.shape[0]):
        kernels.add_powers(transform(first[slab], second[slab]), sums)
    power = sums.sum(axis=0)
    power[1:half] += power[:half:-1]
    return np.asarray(power[: half + 1])


def _quadrature(b: Array) -> tuple[Array, Array]:
    """Return two factors (n,), of Re S and of Im S in Re(i exp(i b) S), for b = omega dt / 2 at signed omega.
    S is a cross spectrum of numpy's transforms, the conjugate of that of waves exp(i (k . x - omega t))."""
    imaginary = np.where(b < 0, -1.0, 1.0) * np.cos(b)
    imaginary[[0, b.size // 2]] = 0.0
    return -np.sin(np.abs(b)), imaginary


def to_frame_time(k: Array, omega: Array, dt: float, frames: int) -> Array:
    """Return the factor that shifts the transform of z from mid-step to the first frame of each step, by dt /
    2. If `frames` exceeds 2, it also corrects the damping of z by interpolation between six frames."""
    start = np.exp(-0.5j * omega * dt)
    if frames <= 2:  # fields of another program
        return np.asarray(start)
    b = dispersion(np.asarray(k, float)) * dt / 2
    amplitude = np.abs(150 * np.cos(b) - 25 * np.cos(3 * b) + 3 * np.cos(5 * b)) / 128
    return np.asarray(start / np.maximum(amplitude, MIN_AMPLITUDE))


def _transform_blocks(
    requested: Requested, welch: Welch, blocks: list[Array], link: Link, memory: dict[str, Array]
) -> dict[str, Array]:
    fields = dict(zip(sources(requested.names), blocks))
    blocks.clear()  # so that `transforms` can release them
    return transforms(fields, requested, welch, memory)


def segment_sums(
    fields: Mapping[str, xr.DataArray] | xr.Dataset, requested: Requested, welch: Welch
) -> dict[str, Array]:
    """Return the sums of `add_segment` over all segments of fields (time, y, x), by name."""
    arrays = [fields[name] for name in sources(requested.names)]
    transform, add = partial(_transform_blocks, requested, welch), partial(add_segment, requested, welch)
    sums: dict[str, Array] = sum_segments(arrays, welch.record, welch.segment, transform, add).compute()
    return sums
