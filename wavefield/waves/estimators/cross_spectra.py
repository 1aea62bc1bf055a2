"""Power and cross spectra of several fields of a cube in one pass, integrated over angle."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import dask
import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import INSTANTANEOUS, annotate, validate
from wavefield.waves.estimation import degrees_of_freedom, segments, transfer_functions, wave_kernels
from wavefield.waves.estimation.current import delayed_current
from wavefield.waves.estimation.degrees_of_freedom import with_interval
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.record import Record
from wavefield.waves.estimation.rings import Rings, half_plane
from wavefield.waves.estimation.welch import Welch, k_coords, omega_coords
from wavefield.waves.estimation.window_gain import correction, with_directions
from wavefield.waves.estimators import field_spectra
from wavefield.waves.products import WaveProduct, register

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
        degrees_of_freedom.take_in(sums, name, powers[name], begin)
    for pair, earlier in before.items():
        degrees_of_freedom.keep_product(sums, pair, sums[pair] - earlier, begin)


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


_MEASURED = {"z_t": "z"}  # the response to differences of elevations is that to elevations


def label(
    sums: Mapping[str, Array],
    names: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    welch: Welch,
    freedom: Mapping[str, Mapping[str, Array]] | None = None,
    samples: Mapping[tuple[str, str], Mapping[str, Array]] | None = None,
) -> xr.Dataset:
    """Labelled spectra from the sums of `sum_segment` over all segments."""
    factor = welch.ring_density
    dims = ("omega", "k")
    out: dict[str, Any] = {}
    dof_k = {}
    for name in names:
        out[f"E_{name}"] = (dims, sums[name][0].T * factor)
        dof = (
            degrees_of_freedom.freedom(sums, name, welch, name != "nl") if freedom is None else freedom[name]
        )
        out[f"dof_{name}"] = (dims, dof["both"].T)
        for axis in ("omega", "k"):
            out[f"dof_{axis}_{name}"] = (axis, dof[axis])
        dof_k[name] = dof["k"]
    for a, b in pairs:
        real, imaginary = sums[f"{a}*{b}"]
        out[f"S_{a}_{b}"] = (dims, (real + 1j * imaginary).T * factor)
        of_pair = {} if samples is None else samples[a, b]
        number = of_pair or degrees_of_freedom.samples(sums, a, b, (dof_k[a], dof_k[b]), welch)
        out[f"samples_{a}_{b}"] = (dims, number["both"].T)
        out[f"samples_k_{a}_{b}"] = ("k", number["k"])
    out["valid"] = (dims, welch.valid)
    coords = omega_coords(welch.omega) | k_coords(welch.table.k)
    return annotate(xr.Dataset(out | dict(welch.ring_variables), coords=coords, attrs=welch.attrs), "cross")


def door(cube: xr.Dataset, names: Sequence[str]) -> xr.Dataset:
    """Fields of a cube that some spectral names are made of, checked, in m and s and of one type."""
    fields = sources(names)
    for field in fields:
        if field not in cube:
            raise CubeError(f"the cube has no {field!r}, which the spectra of {', '.join(names)} are made of")
    return validate(cube, *fields)


@takes(a_cube)
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
        Pairs of these whose cross spectrum is computed.
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
    names: Sequence[str], welch: Welch, blocks: list[Array], first: int
) -> dict[str, Array]:
    fields = dict(zip(sources(names), blocks))
    blocks.clear()  # so that `transforms` can release them
    return transforms(fields, names, welch)


def moving_welch(cube: xr.Dataset, welch: Welch) -> Any:
    """Welch with the mean current of the record, delayed."""

    def with_current(mean_and_std: tuple[Array, Array]) -> Welch:
        mean = mean_and_std[0]
        return replace(welch, current=(float(mean[0]), float(mean[1])))

    return dask.delayed(with_current, pure=False)(delayed_current(cube, welch.record))


def lazy_sums(cube: xr.Dataset, requested: Requested, welch: Welch) -> Any:
    """Sums of `sum_segment` over all segments of a cube that came through `door`; delayed."""
    names = requested.names
    make: Any = partial(_transform_blocks, names)
    if {"nl", "rise"} & {*names}:
        make = dask.delayed(partial, pure=False)(make, moving_welch(cube, welch))
    else:
        make = partial(make, welch)
    return segments.sum_segments(
        [cube[field] for field in sources(names)],
        welch.record,
        welch.half,
        make,
        partial(sum_segment, requested=requested, welch=welch),
    )


def lazy_cross_spectra(
    cube: xr.Dataset, names: Sequence[str], pairs: Sequence[tuple[str, str]], welch: Welch
) -> xr.Dataset:
    """Lazy cross spectra of a cube that came through `door`."""
    sums = lazy_sums(cube, Requested(names, pairs), welch)
    # how long waves stay in the window depends on the current, where the cube has one
    moving = moving_welch(cube, welch) if {"u", "v"} <= {*cube} else welch
    shape = (welch.table.k.size, welch.omega.size)
    fields = (*names, *(f"{a}*{b}" for a, b in pairs))
    arrays = {name: da.from_delayed(sums[name], (2, *shape), float) for name in fields}
    shapes = {"both": shape, "omega": shape[1:], "k": shape[:1]}
    freedom, dof_k = {}, {}
    for name in names:
        dof = dask.delayed(degrees_of_freedom.freedom, pure=False)(sums, name, moving, name != "nl")
        freedom[name] = {axes: da.from_delayed(dof[axes], size, float) for axes, size in shapes.items()}
        dof_k[name] = dof["k"]
    samples = {}
    for a, b in pairs:
        number = dask.delayed(degrees_of_freedom.samples, pure=False)(
            sums, a, b, (dof_k[a], dof_k[b]), moving
        )
        samples[a, b] = {axes: da.from_delayed(number[axes], shapes[axes], float) for axes in ("both", "k")}
    return label(arrays, names, pairs, welch, freedom, samples)


def by_field(ring: xr.Dataset, gain: xr.Dataset | None = None, names: Sequence[str] = NAMES) -> xr.Dataset:
    """E(k, omega), E(k) and E(omega) of each field with their intervals, as the wave store names them."""
    out = xr.Dataset(attrs=ring.attrs)
    for name in names:
        energy, dof = ring[f"E_{name}"], ring[f"dof_{name}"]
        if gain is not None and name not in ("rise", "nl"):
            factor, valid = correction(gain, _MEASURED.get(name, name), ring["k"].values)
            energy = energy * xr.DataArray(factor, dims="k")
            out[f"valid_k_{name}"] = ("k", valid)
        sums = {f"dof_{axis}": ring[f"dof_{axis}_{name}"] for axis in ("omega", "k")}
        komega = xr.Dataset({"E": energy, "dof": dof, **sums}, attrs=ring.attrs)
        spectra = {
            f"komega_{name}": with_interval(energy, dof),
            f"k_{name}": field_spectra.E_k(komega),
            name: field_spectra.E_omega(komega),
        }
        for suffix, spectrum in spectra.items():
            stem = suffix if suffix.startswith("komega") else f"E_{suffix}"
            renamed = {"E": f"E_{suffix}"} | {part: f"{part}_{stem}" for part in ("dof", "low", "high")}
            out = out.assign(spectrum.drop_vars("valid", errors="ignore").rename(renamed).data_vars)
    out = out.assign(coverage=ring["coverage"], cells=ring["cells"], valid_komega=ring["valid"])
    return annotate(out, "spectra")


def _spectra(
    ring: xr.Dataset,
    gain: xr.Dataset | None,
    plane_w: xr.DataArray,
    welch: Welch,
    filled: Mapping[str, float],
) -> xr.Dataset:
    out = by_field(ring, None if gain is None else with_directions(gain, plane_w))
    for name, added in filled.items():
        if added:
            out["valid_komega"] = out["valid_komega"] & welch.over_filled(ring[f"E_{name}"], added)
    return annotate(out, "spectra")


def _ring(sums: Mapping[str, Array], pairs: Sequence[tuple[str, str]], welch: Welch) -> xr.Dataset:
    return label(sums, NAMES, pairs, welch)


register(
    WaveProduct("ring", ("ring_sums", "pairs", "welch"), _ring),
    WaveProduct("spectra", ("ring", "gain", "plane_w", "welch", "filled"), _spectra, group="spectra", cost=2),
)
