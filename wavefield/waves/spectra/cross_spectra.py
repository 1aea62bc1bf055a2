"""Power and cross spectra of several fields of a cube in one pass, integrated over angle."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import dask
import dask.array as da
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import annotate, validate
from wavefield.waves.estimation import segment_variance, segments
from wavefield.waves.estimation.degrees_of_freedom import with_interval
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.mean_current import delayed_current
from wavefield.waves.estimation.wave_record import Record
from wavefield.waves.estimation.welch import Welch, k_coords, omega_coords
from wavefield.waves.estimation.window_gain import correction, with_directions
from wavefield.waves.products import Product, register
from wavefield.waves.spectra import field_spectra
from wavefield.waves.spectra.segment_sums import NAMES, Requested, sources, sum_segment, transforms

Array = NDArray[Any]

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
        dof = segment_variance.freedom(sums, name, welch, name != "nl") if freedom is None else freedom[name]
        out[f"dof_{name}"] = (dims, dof["both"].T)
        for axis in ("omega", "k"):
            out[f"dof_{axis}_{name}"] = (axis, dof[axis])
        dof_k[name] = dof["k"]
    for a, b in pairs:
        real, imaginary = sums[f"{a}*{b}"]
        out[f"S_{a}_{b}"] = (dims, (real + 1j * imaginary).T * factor)
        of_pair = {} if samples is None else samples[a, b]
        number = of_pair or segment_variance.samples(sums, a, b, (dof_k[a], dof_k[b]), welch)
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
        dof = dask.delayed(segment_variance.freedom, pure=False)(sums, name, moving, name != "nl")
        freedom[name] = {axes: da.from_delayed(dof[axes], size, float) for axes, size in shapes.items()}
        dof_k[name] = dof["k"]
    samples = {}
    for a, b in pairs:
        number = dask.delayed(segment_variance.samples, pure=False)(sums, a, b, (dof_k[a], dof_k[b]), moving)
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
    Product("ring", ("ring_sums", "pairs", "welch"), _ring),
    Product("spectra", ("ring", "gain", "plane_w", "welch", "filled"), _spectra, group="spectra", cost=2),
)
