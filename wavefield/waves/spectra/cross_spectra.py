"""Power and cross spectra of several fields of a cube in one pass, integrated over angle.

Names: ``z`` is the elevation at frame times, half a step before the rest; ``nl`` is (u - U) . grad z
and ``rise`` is z_t + U . grad z, U being the mean current: their sum is z_t + u . grad z.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import dask
import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.waves.estimation import (
    degrees_of_freedom,
    segment_variance,
    segments,
    transfer_functions,
    wave_kernels,
)
from wavefield.waves.estimation.mean_current import delayed_current
from wavefield.waves.estimation.rings import Rings, half_plane
from wavefield.waves.estimation.wave_record import Record
from wavefield.waves.estimation.welch import Welch, k_coords, omega_coords
from wavefield.waves.estimation.window_gain import kept
from wavefield.waves.estimation.windows import effective_duration
from wavefield.waves.products import Product, register
from wavefield.waves.spectra import field_spectra

Array = NDArray[Any]

_MEASURED = {"z_t": "z"}  # rises from frame to frame keep what elevations keep
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


def sources(names: Sequence[str]) -> list[str]:
    """Fields of the cube that some spectral names need, in the cube's order."""
    needed = {field for name in names for field in SOURCES[name]}
    return [field for field in ("z", "z_t", "u", "v", "w") if field in needed]


class _Relative:
    """(u - U) . grad z, or z_t + U . grad z: computed where it is cut out, never held whole."""

    def __init__(self, fields: Mapping[str, Array], welch: Welch, name: str) -> None:
        self.name = name
        record = welch.record
        # velocities along paths are those at mid-time, as z is; a displacement goes with its frames' mean
        lean = record.dt / 16 if welch.frames == 2 else 0.0
        self.fields = [np.ascontiguousarray(fields[name]) for name in ("z", "z_t", "u", "v")]
        self.shape, self.dtype = self.fields[0].shape, self.fields[0].dtype
        real = self.dtype.type
        for i, mean in enumerate(welch.current, 2):
            part = self.fields[i]
            self.fields[i] = part - real(mean) if name == "nl" else np.full_like(part, mean)
        self.distances = real(lean), real(record.dt / 2), record.dy, record.dx

    def __getitem__(self, steps: slice) -> Array:
        first, end, _ = steps.indices(self.shape[0])
        out = np.empty((end - first, *self.shape[1:]), self.dtype)
        given = *self.fields, first, *self.distances, out
        wave_kernels.advection(*given)
        if self.name == "rise":
            out += self.fields[1][first:end]
        return out


def transforms(
    fields: dict[str, Array],
    names: Sequence[str],
    welch: Welch,
    old: Mapping[str, Array] | None = None,
) -> dict[str, Array]:
    """Transform a half segment in space.

    With fields (steps, ny, nx); returns (cells, steps): z is still at mid-time: `combine` takes it to frame
    times.
    """
    out, old = {}, old or {}
    relative = [name for name in ("nl", "rise") if name in names]
    for name in relative:
        out[name] = segments.transform_space(_Relative(fields, welch, name), old.get(name))
    requested = {*names} - {*relative} | ({"z_t"} if "z" in names else set())
    for name in [*fields]:
        block = fields.pop(name)
        if name in requested:
            out[name] = segments.transform_space(block, old.get(name))
    return out


def take(names: Sequence[str], blocks: list[Array]) -> dict[str, Array]:
    """Move blocks from a list into a dictionary, so that emptying it frees them."""
    out = dict(zip(names, blocks))
    blocks.clear()
    return out


def combine(
    first: dict[str, Any],
    second: dict[str, Any],
    names: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    maps: Sequence[str],
    welch: Welch,
    begin: int = 0,
) -> dict[str, Array]:
    """Transform a segment in time and sum powers and cross products over rings.

    With first, second (cells, n / 2); pairs (str, str).
    """
    sums = empty_sums(first[names[0]], names, pairs, maps, welch.table)
    add_segment(sums, first, second, names, pairs, maps, welch, begin)
    return sums


def empty_sums(
    half: Array,
    names: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    maps: Sequence[str],
    table: Rings,
) -> dict[str, Array]:
    """Zeros for `add_segment`; ``half`` is any half segment's transform, (cells, n / 2)."""
    cells, steps = half.shape
    shape = (table.k.size, steps + 1)
    sums = {name: np.zeros((2, *shape)) for name in (*names, *(f"{a}*{b}" for a, b in pairs))}
    return sums | {f"map {name}": np.zeros((cells, 2 * steps), half.real.dtype) for name in maps}


def add_segment(
    sums: dict[str, Array],
    first: dict[str, Any],
    second: dict[str, Any],
    names: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    maps: Sequence[str],
    welch: Welch,
    begin: int,
) -> None:
    """As `combine`, added to ``sums``."""
    table, dt = welch.table, welch.record.dt
    cells, half = first[names[0]].shape
    transform = segments.TimeTransform(half, first[names[0]].dtype, len(names) + 1)
    mine = {name: np.zeros_like(sums[name]) for name in names}  # of this segment alone
    signed = 2 * np.pi * np.fft.fftfreq(2 * half, dt)
    forward = transfer_functions.to_frame_time(signed, dt, welch.frames, welch.z_frames).astype(
        first[names[0]].dtype
    )
    k = half_plane(*welch.record.shape, welch.record.dy, welch.record.dx)
    frames = _FrameTimes(first, second, dt) if "z" in names and welch.frames == 2 else None
    turns = [turn.astype(first[names[0]].real.dtype) for turn in _quadrature(signed * dt / 2)]
    for slab in segments.slabs(cells):
        start = table.start[slab.start : slab.stop + 1]
        lines = {}
        for i, name in enumerate(names):
            one, two = first[name][slab], second[name][slab]
            if name == "z" and frames is not None:
                one, two = frames(slab)
            lines[name] = transform(one, two, i)
            if name == "z" and welch.moving:
                lines[name] *= transfer_functions.from_moving_frame(k[slab, None], signed, dt)
            elif name == "z" and frames is None:
                lines[name] += forward * transform(first["z_t"][slab], second["z_t"][slab], len(names))
            wave_kernels.ring_powers(lines[name], start, table.ring, table.weight, table.spread, mine[name])
            if name in maps:
                wave_kernels.add_powers(lines[name], sums[f"map {name}"][slab])
        for a, b in pairs:
            wave_kernels.ring_cross_spectra(
                lines[a], lines[b], start, table.ring, table.weight, sums[f"{a}*{b}"]
            )
            if f"{a}*{b}" in maps:
                to = sums[f"map {a}*{b}"][slab]
                wave_kernels.add_products(lines[a], lines[b], turns[0], turns[1], to)
    for name in names:
        segment_variance.take_in(sums, name, mine[name], begin)


def _quadrature(b: Array) -> tuple[Array, Array]:
    # factors of the real and the imaginary part of a product, in numpy's signs; `b` is omega dt / 2, signed
    imaginary = np.where(b < 0, -1.0, 1.0) * np.cos(b)
    imaginary[[0, b.size // 2]] = 0.0
    return -np.sin(np.abs(b)), imaginary


class _FrameTimes:
    """Takes z of a segment to frame times, exactly: z and the differences z_t hold the frames."""

    def __init__(self, first: Mapping[str, Array], second: Mapping[str, Array], dt: float) -> None:
        self.dtype = first["z"].dtype
        self.real = self.dtype.type(0).real.dtype
        self.halves = [part[name].T.view(self.real) for name in ("z", "z_t") for part in (first, second)]
        self.dt = self.real.type(dt)
        self.steps = first["z"].shape[1]

    def __call__(self, slab: slice) -> tuple[Array, Array]:
        starts = [np.empty((self.steps, slab.stop - slab.start), self.dtype) for _ in range(2)]
        parts = [part.view(self.real) for part in starts]
        given = *self.halves, self.dt, 2 * slab.start, *parts
        wave_kernels.frames(*given)
        return starts[0].T, starts[1].T


def label(
    sums: Mapping[str, Any],
    names: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    welch: Welch,
    freedom: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Turn ring sums into a labelled dataset."""
    factor = welch.ring_density
    dims = ("omega", "k")
    out: dict[str, Any] = {}
    for name in names:
        out[f"E_{name}"] = (dims, sums[name][0].T * factor)
        found = (
            segment_variance.freedom(sums, name, welch, name != "nl") if freedom is None else freedom[name]
        )
        out[f"dof_{name}"] = (dims, found["both"].T)
        for axis in ("omega", "k"):
            out[f"dof_{axis}_{name}"] = (axis, found[axis])
    for a, b in pairs:
        real, imaginary = sums[f"{a}*{b}"]
        out[f"S_{a}_{b}"] = (dims, (real + 1j * imaginary).T * factor)
    out["valid"] = (dims, welch.valid)
    coords = omega_coords(welch.omega) | k_coords(welch.table.k)
    return annotate(xr.Dataset(out | dict(welch.ring_variables), coords=coords, attrs=welch.attrs), "cross")


def door(cube: Any, names: Sequence[str]) -> xr.Dataset:
    """Fields of a cube that some spectral names are made of, checked, in m and s and of one type."""
    fields = sources(names)
    for field in fields:
        if field not in cube:
            raise CubeError(f"the cube has no {field!r}, which the spectra of {', '.join(names)} are made of")
    return validate(cube, *fields)


def cross_spectra(
    cube: xr.Dataset,
    names: Sequence[str],
    pairs: Sequence[tuple[str, str]] = (),
    *,
    segment: int | None = None,
    record: Record | None = None,
) -> xr.Dataset:
    """Power and cross spectra of fields of a cube in one pass.

    Parameters
    ----------
    cube : Dataset
        Fields over (time, y, x), m and m/s. Lazy input gives a lazy result.
    names : sequence of str
        Of z (at frame times), z_t, u, v, w, nl ((u - U) . grad z) and rise (z_t + U . grad z), with U the
        mean of u, v over the record.
    pairs : sequence of (str, str)
        Pairs of these whose cross spectrum is wanted.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``E_<name>``, ``dof_<name>`` (degrees of freedom) and ``S_<a>_<b>`` = <conj(a) b> over (omega, k),
        ``coverage``, ``cells`` (k), ``valid`` (omega, k).

    Raises
    ------
    CubeError
        If a field is missing, the record is shorter than a segment or no full rectangle is left.

    Notes
    -----
    The phase of S is that of waves exp(i (k . x - omega t)) with omega > 0, averaged over all directions.
    """
    cube = door(cube, names)
    lazy = lazy_cross_spectra(cube, names, pairs, Welch.of(cube, segment, record))
    return field_spectra.finish(lazy, cube[sources(names)[0]])


def _transform_blocks(
    fields: Sequence[str], names: Sequence[str], welch: Welch, blocks: list[Array], first: int
) -> dict[str, Array]:
    return transforms(take(fields, blocks), names, welch)


def moving_welch(cube: xr.Dataset, welch: Welch) -> Any:
    """Welch with the mean current of the record, delayed."""

    def with_current(found: tuple[Array, Array]) -> Welch:
        return replace(welch, current=(float(found[0][0]), float(found[0][1])))

    return dask.delayed(with_current, pure=False)(delayed_current(cube, welch.record))


def lazy_sums(
    cube: xr.Dataset,
    names: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    maps: Sequence[str],
    welch: Welch,
) -> Any:
    """As `combine` gives it, over all segments of a cube that came through `door`; delayed."""
    fields = sources(names)

    make: Any = partial(_transform_blocks, fields, names)
    if {"nl", "rise"} & {*names}:
        make = dask.delayed(partial, pure=False)(make, moving_welch(cube, welch))
    else:
        make = partial(make, welch)
    runs = segments.half_segments([cube[field] for field in fields], welch.record, welch.half, make)
    task = dask.delayed(combine, pure=False)
    return segments.in_order(
        [
            task(a, b, names, pairs, maps, welch, begin)
            for run, (start, _) in zip(runs, welch.record.runs)
            for begin, (a, b) in zip(itertools.count(start, welch.half), pairwise(run))
        ]
    )


def lazy_cross_spectra(
    cube: xr.Dataset, names: Sequence[str], pairs: Sequence[tuple[str, str]], welch: Welch
) -> xr.Dataset:
    """As `cross_spectra`, lazy whatever the cube is, which came through `door`."""
    summed = lazy_sums(cube, names, pairs, (), welch)
    shape = (welch.table.k.size, welch.omega.size)
    requested = (*names, *(f"{a}*{b}" for a, b in pairs))
    sums = {name: da.from_delayed(summed[name], (2, *shape), float) for name in requested}
    shapes = {"both": shape, "omega": shape[1:], "k": shape[:1]}
    freedom = {}
    for name in names:
        found = dask.delayed(segment_variance.freedom, pure=False)(summed, name, welch, name != "nl")
        freedom[name] = {of: da.from_delayed(found[of], size, float) for of, size in shapes.items()}
    return label(sums, names, pairs, welch, freedom)


def by_field(ring: xr.Dataset, gain: xr.Dataset | None = None) -> xr.Dataset:
    """E(k, omega), E(k) and E(omega) of each field with their intervals, as the wave store names them."""
    step = float(ring["omega"][1] - ring["omega"][0])
    duration = effective_duration(ring.attrs["segments"], ring.attrs["segment"] * ring.attrs["dt"])
    out = xr.Dataset(attrs=ring.attrs)
    for name in NAMES:
        energy, dof = ring[f"E_{name}"], ring[f"dof_{name}"]
        if gain is not None and name not in ("rise", "nl"):
            factor, there = kept(gain, _MEASURED.get(name, name), ring["k"].values)
            energy = energy * xr.DataArray(factor, dims="k")
            out[f"valid_k_{name}"] = ("k", there)
        whole = {"E": energy, "dof": dof, "dof_omega": ring[f"dof_omega_{name}"]}
        cells = dof / ring.attrs["degrees_of_freedom"]
        theory = 2 * degrees_of_freedom.samples_in_time(energy, duration, cells).clip(min=1)
        dof_k = ring[f"dof_k_{name}"].fillna(theory)
        parts = {
            f"komega_{name}": degrees_of_freedom.with_interval(energy, dof),
            f"k_{name}": degrees_of_freedom.with_interval(energy.sum("omega") * step, dof_k),
            name: field_spectra.frequency_spectrum(xr.Dataset(whole, attrs=ring.attrs)),
        }
        for of, part in parts.items():
            stem = of if of.startswith("komega") else f"E_{of}"
            names_there = {"E": f"E_{of}"} | {n: f"{n}_{stem}" for n in ("dof", "low", "high")}
            out = out.assign(part.drop_vars("valid", errors="ignore").rename(names_there).data_vars)
    out = out.assign(coverage=ring["coverage"], cells=ring["cells"], valid_komega=ring["valid"])
    return annotate(out, "spectra")


def _ring(sums: Mapping[str, Array], pairs: Sequence[tuple[str, str]], welch: Welch) -> xr.Dataset:
    return label(sums, NAMES, pairs, welch)


register(
    Product("ring", ("ring_sums", "pairs", "welch"), _ring),
    Product("spectra", ("ring", "gain"), by_field, group="spectra", cost=2),
)
