"""Power spectra of a field: E(omega, ky, kx), E(k, omega), E(omega) and E(k), by Welch's method.

Transforms hold only kx >= 0, because the spectrum of a real field is symmetric.
"""

from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.errors import CubeError
from wavefield.variables import FIELD_TEXTS, FIELD_UNITS, TABLE, annotate, density_units
from wavefield.waves.dof import ring_freedom, with_interval
from wavefield.waves.inputs import (
    a_field,
    described,
    is_cube,
    is_field,
    keep_water,
    takes,
    water_parameters,
)
from wavefield.waves.products import WaveProduct, register
from wavefield.waves.record import Record, filled_density
from wavefield.waves.sums import Requested, segment_sums
from wavefield.waves.welch import MIN_OVER_FILLED, Welch, inner, interval, k_coords, omega_coords

Array = NDArray[Any]


def a_komega(given: Any, name: str) -> tuple[xr.Dataset, dict[str, Any]]:
    """Return E(k, omega): `given` itself if it is a result of `komega`, or the spectrum of a field `given`.
    Raises CubeError for other arguments, with `name`, the name of the estimator, in the message."""
    if is_field(given):
        return komega(given), {}
    if isinstance(given, xr.Dataset) and "E" in given and {"omega", "k"} <= {*given["E"].dims}:
        return given, {}
    raise CubeError(
        f"{name} needs one variable over time, y and x (for example cube.w) or the result of"
        f" wavefield.komega, got {described(given)}"
    )


def _name(field: xr.DataArray) -> str:
    return str(field.attrs.get("long_name", field.name))


def unfold(power: Array, ny: int, nx: int) -> Array:
    """Return the power at omega >= 0 in the whole k plane, (n // 2 + 1, ny, nx), from `power` at kx >= 0. In
    the result, k points where waves go; in numpy's transform, cos(k . x - omega t) is at (k, -omega)."""
    n = power.shape[-1]
    power = power.reshape(ny, nx // 2 + 1, n)
    columns = np.arange(nx)
    right = columns <= nx // 2
    out = np.empty((n // 2 + 1, ny, nx), power.dtype)
    backward = np.r_[0, np.arange(n - 1, n // 2 - 1, -1)]  # numpy's index of -omega
    out[:, :, right] = np.moveaxis(power[:, :, backward], 2, 0)
    mirror = power[(-np.arange(ny)) % ny][:, nx - columns[~right]][:, :, : n // 2 + 1]
    out[:, :, ~right] = np.moveaxis(mirror, 2, 0)
    out[1:-1] *= 2
    return np.fft.fftshift(out, axes=(1, 2))


def density(power: Array, welch: Welch) -> Array:
    """Return E(omega, ky, kx) from `power` (cells, n) at kx >= 0, summed over segments."""
    values = unfold(power, *welch.record.shape)
    values *= power.dtype.type(welch.density)
    return values


@takes(a_field)
def spectrum(field: xr.DataArray, *, segment: int | None = None, record: Record | None = None) -> xr.Dataset:
    """Power spectrum E(omega, ky, kx) of a field.

    Parameters
    ----------
    field : DataArray, (time, y, x)
        Any variable of a cube; time in s, x and y in m.
    segment : int, optional
        Steps of a Welch segment, even; by default about a quarter of the longest run of steps, 64 to 512.
    record : Record, optional
        Result of `wavefield.waves.record.find_record`, by default for this field.

    Returns
    -------
    Dataset
        ``E`` (omega, ky, kx), in the field's units squared per (rad/m)^2 and rad/s; its degrees of
        freedom ``dof``; ``low`` and ``high``, factors from E to the limits of its 95 % interval.

    Raises
    ------
    CubeError
        If the record is shorter than a segment, its steps are unequal or fewer than 8 x 8 nodes are measured.

    Notes
    -----
    E = dt dy dx / ((2 pi)^3 sum W^2) <|FFT(W f)|^2>, with the Hann window W in time, y and x, the mean <>
    over segments that overlap by half, and a factor 2 for 0 < omega < Nyquist. The integral of E is the
    weighted variance <W^2 f^2> / <W^2>. The mean and trend in time are removed.

    Examples
    --------
    The integral of a spectrum is about the variance of its field.

    >>> import wavefield as wf
    >>> from wavefield.waves.spectra import total  # the integral of a spectrum
    >>> z = wf.open_cube("sea.zarr").z
    >>> E = wf.spectrum(z).E
    >>> E.dims, round(float(total(E) / z.var()), 1)
    (('omega', 'ky', 'kx'), 1.0)
    """
    welch = Welch.of(field, segment, record)
    summed = segment_sums({"f": field}, Requested(("f",), planes=("f",)), welch)
    values = xr.Variable(("omega", "ky", "kx"), density(summed["map f"], welch))
    out = plane_density(values, _name(field), field.attrs.get("units", "1"), welch)
    return keep_water(out, field)


def plane_density(values: object, name: str, units: str, welch: Welch) -> xr.Dataset:
    """Return a Dataset of `values`, E(omega, ky, kx) of a field `name` in `units`, with 95 % interval."""
    low, high = interval(welch.dof)
    parts = {"E": values, "dof": ((), welch.dof), "low": ((), float(low)), "high": ((), float(high))}
    out = xr.Dataset(parts, coords=omega_coords(welch.omega) | welch.plane, attrs=welch.attrs)
    out = annotate(out, "plane")
    out["E"].attrs = TABLE["plane/E"].of(name, density_units(units, "k", "k", "omega"))
    return out


def total(density: xr.DataArray) -> xr.DataArray:
    """Return the integral of a spectrum over its axes omega, k, ky, kx: the variance of the field."""
    out = density
    for name in ("omega", "k", "ky", "kx"):
        if name in density.dims:
            out = out.sum(name, dtype=np.float64) * float(density[name][1] - density[name][0])
    return out


@takes(a_field)
def komega(field: xr.DataArray, *, segment: int | None = None, record: Record | None = None) -> xr.Dataset:
    """Spectrum E(k, omega): the power spectrum integrated over the angle of the wave vector.

    Parameters
    ----------
    field : DataArray, (time, y, x)
        Any variable of a cube; time in s, x and y in m. A field on disk is read in pieces.
    segment : int, optional
        Steps of a Welch segment, even; by default about a quarter of the longest run of steps, 64 to 512.
    record : Record, optional
        Result of `wavefield.waves.record.find_record`, by default for this field.

    Returns
    -------
    Dataset
        Over (omega, k): ``E``, in the field's units squared per rad/m and rad/s; its degrees of freedom
        ``dof``; ``low`` and ``high``, factors from E to the limits of its 95 % interval; ``valid``, a mask of
        reliable values. ``dof_omega`` and ``dof_k``, degrees of freedom of E(omega) and E(k). Over k:
        ``coverage``, the sampled fraction of a ring of |k|; ``cells``, its independent wave vectors.

    Raises
    ------
    CubeError
        If the record is shorter than a segment, its steps are unequal or fewer than 8 x 8 nodes are measured.

    Notes
    -----
    E is the integral of `spectrum` over rings of |k|, between which the cells of the k plane are divided by
    area. The mean over directions is E / (2 pi k coverage).

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.komega(wf.open_cube("sea.zarr").w)
    >>> found.E.dims, int(found.segments)
    (('omega', 'k'), 7)
    """
    return ring_spectrum(field, segment, record)


def ring_spectrum(
    field: xr.DataArray, segment: int | None = None, record: Record | None = None, nodes: bool = False
) -> xr.Dataset:
    """Return the Dataset of `komega`. If `nodes` is true and no node is missing, add ``E_nodes`` (omega).
    ``E_nodes`` is the mean of the frequency spectra of all nodes, with ``dof_omega`` degrees of freedom."""
    welch = Welch.of(field, segment, record)
    table = welch.table
    # interpolated nodes near the edges are less accurate; only the spatial window gives them little weight
    nodes = nodes and not welch.record.holes
    summed = segment_sums({"f": field}, Requested(("f",), nodes=nodes), welch)
    freedom = ring_freedom(summed, "f", welch)
    both = ("omega", "k")
    energy = xr.DataArray((summed["f"][0] * welch.ring_density).T, dims=both)
    out = with_interval(energy, xr.DataArray(freedom["both"].T, dims=both))
    out["dof_omega"], out["dof_k"] = ("omega", freedom["omega"]), ("k", freedom["k"])
    if nodes:
        out["E_nodes"] = ("omega", summed["nodes"] * welch.node_density)
    out = out.assign(welch.ring_variables).assign_coords(omega_coords(welch.omega) | k_coords(table.k))
    added = filled_density(welch.record, field)
    valid = xr.DataArray(welch.valid, dims=("omega", "k"))
    out["valid"] = valid & welch.over_filled(out["E"], added) if added else valid
    out.attrs["filled_density"] = added
    field_units = field.attrs.get("units", "1")
    out = annotate(out.assign_attrs(welch.attrs, field=_name(field), field_units=field_units), "komega")
    if "E_nodes" in out:
        out["E_nodes"].attrs = TABLE["omega/E"].of(_name(field), density_units(field_units, "omega"))
    out["E"].attrs = TABLE["komega/E"].of(_name(field), density_units(field_units, "k", "omega"))
    return keep_water(out, field)


def _attrs_of_sum(given: xr.DataArray | xr.Dataset, axis: str) -> dict[str, Any]:
    """Return name and units of E(omega) or E(k); `axis`, "omega" or "k", is the axis that remains."""
    if "field" not in given.attrs:  # several quantities of an analysis
        return TABLE[f"spectra/E_{axis}"].attrs
    return TABLE[f"{axis}/E"].of(given.attrs["field"], density_units(given.attrs["field_units"], axis))


def _over_nodes(given: Any, name: str) -> tuple[xr.Dataset, dict[str, Any]]:
    return (ring_spectrum(given, nodes=True), {}) if is_field(given) else a_komega(given, name)


@takes(_over_nodes)
def E_omega(field: xr.DataArray | xr.Dataset) -> xr.Dataset:
    """Frequency spectrum E(omega) of a field, with its 95 % interval.

    Parameters
    ----------
    field : DataArray or Dataset
        Any variable of a cube over (time, y, x), s and m, or the result of `komega`.

    Returns
    -------
    Dataset
        Over omega: ``E``, in the field's units squared per rad/s; its degrees of freedom ``dof``; ``low`` and
        ``high``, factors from E to the limits of its 95 % interval; ``valid``, true where E is reliable.

    Raises
    ------
    CubeError
        If the input is neither a field nor a result of `komega`, or the field is too short or too small.

    Notes
    -----
    For a field, E is the mean of the spectra of all nodes. If nodes are missing, or for a result of `komega`,
    it is the integral of E(k, omega) over k, whose spatial window makes the variance up to twice as large.

    Examples
    --------
    >>> import wavefield as wf
    >>> wf.E_omega(wf.open_cube("sea.zarr").w).E.dims
    ('omega',)
    """
    step = float(field["k"][1] - field["k"][0])
    energy = field["E_nodes"] if "E_nodes" in field else field["E"].sum("k", dtype=np.float64) * step
    out = with_interval(energy, field["dof_omega"])
    added = float(field.attrs.get("filled_density", 0.0))
    out["valid"] = xr.DataArray(inner(out.sizes["omega"]), dims="omega")
    if added:
        out["valid"] = out["valid"] & (energy > MIN_OVER_FILLED * added)
    out = annotate(out)
    out["E"].attrs = _attrs_of_sum(field, "omega")
    return out


@takes(a_komega)
def E_k(field: xr.DataArray | xr.Dataset) -> xr.Dataset:
    """Wavenumber spectrum E(k) of a field, with its 95 % interval.

    Parameters
    ----------
    field : DataArray or Dataset
        Any variable of a cube over (time, y, x), s and m, or the result of `komega`.

    Returns
    -------
    Dataset
        Over k: ``E``, the integral of E(k, omega) over omega, in the field's units squared per rad/m; its
        degrees of freedom ``dof``; ``low`` and ``high``, factors from E to the limits of its 95 %
        interval.

    Raises
    ------
    CubeError
        If the input is neither a field nor a result of `komega`, or the field is too short or too small.

    Examples
    --------
    >>> import wavefield as wf
    >>> wf.E_k(wf.open_cube("sea.zarr").w).E.dims
    ('k',)
    """
    step = float(field["omega"][1] - field["omega"][0])
    out = with_interval(field["E"].sum("omega") * step, field["dof_k"])
    out = annotate(out)
    out["E"].attrs = _attrs_of_sum(field, "k")
    return out


PLANE = {"omega", "ky", "kx"}


def a_plane(given: Any, name: str, segment: int | None = None) -> tuple[xr.DataArray, dict[str, Any]]:
    """Return E(omega, ky, kx) from `given`, and its water parameters and degrees of freedom, where known.
    `given` is such a spectrum, a field, or a cube, of which w is used; CubeError for the estimator `name` if
    it is anything else. `segment` is the number of steps in a Welch segment."""
    water: dict[str, Any] = water_parameters(given) if isinstance(given, xr.DataArray | xr.Dataset) else {}
    if isinstance(given, xr.DataArray) and set(given.dims) == PLANE:
        return given, water
    if is_cube(given):
        if "w" not in given:
            raise CubeError(f"the cube has no 'w': {name} needs its spectrum")
        given = given["w"]
    if is_field(given):
        given = spectrum(given, segment=segment)
    if isinstance(given, xr.Dataset) and "E" in given and set(given["E"].dims) == PLANE:
        return given["E"], water | ({"dof": float(given["dof"])} if "dof" in given else {})
    raise CubeError(
        f"{name} needs a spectrum over omega, ky and kx (`wavefield.spectrum`), a cube, or a field over"
        f" time, y and x, got {described(given)}"
    )


def _density(name: str, sums: dict[str, NDArray[np.floating]], welch: Welch) -> xr.DataArray:
    """Return E(omega, ky, kx) of the field `name` from `sums`, and delete the field's sums to free memory."""
    power = sums.pop(f"map {name}")  # frees memory: no other product needs it
    values = xr.Variable(("omega", "ky", "kx"), density(power, welch))
    return plane_density(values, FIELD_TEXTS[name], FIELD_UNITS[name], welch)["E"]


MAP_FREQUENCIES = (1.5, 2.0, 2.8, 4.0)  # Hz, of the maps E(ky, kx); 2.8 Hz is that of the paper


def map_lines(welch: Welch) -> list[int]:
    """Return the indices of the frequencies nearest to `MAP_FREQUENCIES`, without zero and Nyquist."""
    lines = welch.omega / (2 * np.pi)
    return sorted({int(np.abs(lines - f).argmin()) for f in MAP_FREQUENCIES if f < lines[-2]} - {0})


def maps(z: xr.DataArray, w: xr.DataArray, welch: Welch) -> xr.Dataset:
    """Return ``E_kxky`` (quantity_map, omega_map, ky, kx): E of z and w at the frequencies `map_lines`."""
    parts = [field.isel(omega=map_lines(welch)) for field in (z, w)]
    both = xr.concat(parts, xr.Variable("quantity_map", ["z", "w"]))
    return both.drop_vars("frequency").rename(omega="omega_map").drop_attrs().to_dataset(name="E_kxky")


register(
    *(
        WaveProduct(f"density_{name}", ("ring_sums", "welch"), partial(_density, name), planes=(name,))
        for name in ("z", "w")
    ),
    WaveProduct("plane_w", ("density_w",), lambda w: w.sum("omega")),  # smaller, for workers
    WaveProduct("maps", ("density_z", "density_w", "welch"), maps, group="spectra"),
)
