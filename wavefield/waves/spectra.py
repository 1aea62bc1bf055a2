"""Spectra of a field over (time, y, x): E(ky, kx, omega), E(k, omega), E(ky, kx), E(omega), E(k).

Every spectrum is a density in rad/m and rad/s, one-sided in omega; k points where the wave goes.
"""

import itertools
from typing import Any

import dask
import dask.array as da
import numpy as np
import xarray as xr

from wavefield.errors import CubeError
from wavefield.waves import kernels, rings, segments
from wavefield.waves.record import Record, find_record
from wavefield.waves.units import product
from wavefield.waves.windows import degrees_of_freedom, interval

K_UNITS, OMEGA_UNITS = "rad m-1", "rad s-1"
_LOWEST = 2  # cells: a Hann window mixes what is nearer to zero with the mean


# ---- coordinates -------------------------------------------------------------------------------------------
def omega_axis(segment: int, dt: float) -> np.ndarray:
    """Angular frequencies of a segment, (segment // 2 + 1,), rad/s."""
    return 2 * np.pi * np.arange(segment // 2 + 1) / (segment * dt)


def omega_coords(omega: np.ndarray) -> dict[str, Any]:
    """Coordinates ``omega`` (rad/s) and ``frequency`` (Hz)."""
    return {
        "omega": ("omega", omega, {"long_name": "angular frequency", "units": OMEGA_UNITS}),
        "frequency": ("omega", omega / (2 * np.pi), {"long_name": "frequency", "units": "Hz"}),
    }


def k_coords(k: np.ndarray) -> dict[str, Any]:
    """Coordinates ``k`` (rad/m) and ``cycles`` (1/m)."""
    return {
        "k": ("k", k, {"long_name": "wavenumber", "units": K_UNITS}),
        "cycles": ("k", k / (2 * np.pi), {"long_name": "wavenumber / 2 pi", "units": "m-1"}),
    }


def plane_coords(record: Record) -> dict[str, Any]:
    """Coordinates ``ky`` and ``kx`` (rad/m), ascending."""
    ny, nx = record.shape
    out = {}
    for name, n, step in (("ky", ny, record.dy), ("kx", nx, record.dx)):
        values = np.sort(rings.wavenumbers(n, step))
        out[name] = (name, values, {"long_name": f"wavenumber along {name[1]}", "units": K_UNITS})
    return out


def ring_table(record: Record, dk: float | None = None) -> rings.Rings:
    """Rings of the k plane of a record."""
    ny, nx = record.shape
    return rings.rings(ny, nx, record.dy, record.dx, dk)


def _field(field: Any) -> xr.DataArray:
    if not isinstance(field, xr.DataArray):
        raise CubeError(
            f"expected one variable over time, y and x (for example cube.w), got {type(field).__name__}"
        )
    return field


def setting(field: xr.DataArray, segment: int | None, record: Record | None) -> tuple[Record, int, int]:
    """Record, segment length and number of segments to use for a field."""
    record = find_record(field) if record is None else record
    segment = segments.segment_length(record, segment)
    return record, segment, segments.count_segments(record, segment)


def density(record: Record, segment: int, count: int) -> float:
    """Factor from summed |F|^2 to a two-sided density in rad/m, rad/m and rad/s."""
    energy = segments.window_energy(segment, *record.shape)
    cell = record.dt * record.dy * record.dx
    return cell / ((2 * np.pi) ** 3 * energy * count)


def provenance(record: Record, segment: int, count: int) -> dict[str, Any]:
    """Attributes that say how a spectrum was estimated."""
    return {
        "estimator": "Welch, Hann windows in t, y and x, half overlap, mean and trend removed",
        "segment": segment,
        "segments": count,
        "degrees_of_freedom": degrees_of_freedom(count),
        "steps_bridged": len(record.bridged),
        "nodes_filled": record.holes,
        "nodes": list(record.shape),
        "node_step": [record.dy, record.dx],
        "convention": "k points where the wave goes; density in rad/m and rad/s, one-sided in omega",
    }


def finish(dataset: xr.Dataset, field: xr.DataArray) -> xr.Dataset:
    """Compute a result where its input was in memory; leave it lazy where the input was chunked."""
    return dataset if field.chunks is not None else dataset.compute()


# ---- E(ky, kx, omega) --------------------------------------------------------------------------------------
def _transform(blocks: list[np.ndarray], first: int) -> dict[str, np.ndarray]:
    return {"f": segments.transform_space(blocks.pop())}


def _powers(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    cells, half = a["f"].shape
    power = np.zeros((cells, 2 * half), a["f"].real.dtype)
    transform = segments.TimeTransform(half, a["f"].dtype)
    for slab in segments.slabs(cells):
        kernels.add_powers(transform(a["f"][slab], b["f"][slab]), power[slab])
    return {"power": power}


def unfold(power: np.ndarray, ny: int, nx: int) -> np.ndarray:
    """Bring the power on the half plane to omega >= 0 and the full plane, k pointing where the wave goes.

    Parameters
    ----------
    power : ndarray, (ny * (nx // 2 + 1), n)
        |F|^2 in numpy's order and signs.
    ny, nx : int
        Nodes.

    Returns
    -------
    ndarray, (n // 2 + 1, ny, nx)
        One-sided in omega, k ascending along both axes.

    Notes
    -----
    cos(k . x - omega t) appears in numpy's transform at (k, -omega) and (-k, omega).
    """
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


def _map(total: dict[str, np.ndarray], factor: float, shape: tuple[int, int]) -> np.ndarray:
    power = total["power"]
    return unfold(power, *shape) * power.dtype.type(factor)


def spectrum(field: xr.DataArray, *, segment: int | None = None, record: Record | None = None) -> xr.Dataset:
    """Power spectrum E(ky, kx, omega).

    Parameters
    ----------
    field : DataArray, (time, y, x)
        Any variable of a cube; s and m. Lazy input gives a lazy result.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs (`find_record`); found from the field if not given.

    Returns
    -------
    Dataset
        ``E`` (omega, ky, kx), ``dof``, and the factors ``low`` and ``high`` of the 95 % interval.

    Raises
    ------
    CubeError
        If the record is shorter than a segment, its axes are uneven or no full rectangle is left.

    Notes
    -----
    E = dt dy dx / ((2 pi)^3 sum W^2) <|FFT(W f)|^2>, twice that for 0 < omega < Nyquist: the sum of
    E domega dkx dky is <W^2 f^2> / <W^2>.

    Examples
    --------
    A wave of 1 cm amplitude along x; its variance is half the square of that.

    >>> t, y, x = np.arange(128) * 0.05, np.arange(32) * 0.05, np.arange(40) * 0.05
    >>> wave = 0.01 * np.cos(12.3 * x - 10.98 * t[:, None, None] + 0 * y[:, None])
    >>> z = xr.DataArray(wave, {"time": t, "y": y, "x": x}, ("time", "y", "x"), attrs={"units": "m"})
    >>> E = spectrum(z).E
    >>> peak = E.isel(E.argmax(...))
    >>> round(float(peak.kx)), round(float(peak.omega))
    (13, 12)
    >>> round(float(total(E) / (0.01**2 / 2)), 2)
    1.0
    """
    field = _field(field)
    record, segment, count = setting(field, segment, record)
    runs = segments.half_segments([field], record, segment // 2, _transform)
    task = dask.delayed(_powers, pure=False)
    summed = segments.in_order([task(a, b) for run in runs for a, b in itertools.pairwise(run)])
    lazy = dask.delayed(_map, pure=False)(summed, density(record, segment, count), record.shape)
    omega = omega_axis(segment, record.dt)
    dtype = np.float32 if field.dtype == np.float32 else np.float64
    shape = (omega.size, *record.shape)
    units = product((field.attrs.get("units", "1"), 2), (K_UNITS, -2), (OMEGA_UNITS, -1))
    dof = degrees_of_freedom(count)
    low, high = interval(dof)
    out = xr.Dataset(
        {
            "E": (
                ("omega", "ky", "kx"),
                da.from_delayed(lazy, shape, dtype),
                {
                    "long_name": f"power spectrum of {field.attrs.get('long_name', field.name)}",
                    "units": units,
                },
            ),
            "dof": ((), dof, {"long_name": "degrees of freedom of a cell", "units": "1"}),
            "low": ((), float(low), {"long_name": "lower end of the 95 % interval, factor", "units": "1"}),
            "high": ((), float(high), {"long_name": "upper end of the 95 % interval, factor", "units": "1"}),
        },
        coords=omega_coords(omega) | plane_coords(record),
        attrs=provenance(record, segment, count),
    )
    return finish(out, field)


def total(density: xr.DataArray) -> xr.DataArray:
    """Integrate a spectrum over all its axes (omega, k, ky, kx): the variance.

    Parameters
    ----------
    density : DataArray
        Any spectrum of this package.

    Returns
    -------
    DataArray
        Sum times the cell.
    """
    out = density
    for name in ("omega", "k", "ky", "kx"):
        if name in density.dims:
            out = out.sum(name, dtype=np.float64) * float(density[name][1] - density[name][0])
    return out


# ---- E(k, omega) -------------------------------------------------------------------------------------------
def _ring_powers(
    a: dict[str, np.ndarray],
    b: dict[str, np.ndarray],
    start: np.ndarray,
    ring: np.ndarray,
    weight: np.ndarray,
    spread: np.ndarray,
) -> dict[str, np.ndarray]:
    cells, half = a["f"].shape
    out = np.zeros((2, int(ring.max()) + 1, half + 1))
    transform = segments.TimeTransform(half, a["f"].dtype)
    for slab in segments.slabs(cells):
        lines = transform(a["f"][slab], b["f"][slab])
        kernels.ring_powers(lines, start[slab.start : slab.stop + 1], ring, weight, spread, out)
    return {"f": out}


def ring_density(record: Record, segment: int, count: int, dk: float) -> float:
    """Factor from ring sums of |F|^2 to E(k, omega)."""
    ny, nx = record.shape
    cell = (2 * np.pi) ** 2 / (ny * record.dy * nx * record.dx)
    return density(record, segment, count) * cell / dk


def valid_komega(table: rings.Rings, omega: np.ndarray, record: Record) -> np.ndarray:
    """Where E(k, omega) can be trusted, (omega, k): off the lowest cells, below Nyquist along both axes."""
    nyquist = np.pi / max(record.dy, record.dx)
    edges = table.k + table.dk / 2
    in_k = (table.k > _LOWEST * table.dk) & (edges <= nyquist * (1 + 1e-9))
    index = np.arange(omega.size)
    in_omega = (index >= _LOWEST) & (index < omega.size - 1)
    return in_omega[:, None] & in_k


def ring_freedom(sums: Any, table: rings.Rings, count: int) -> Any:
    """Degrees of freedom of E(k, omega) from how the energy is spread over the cells of each ring.

    Parameters
    ----------
    sums : array, (2, rings, n // 2 + 1)
        Power and squared power as `kernels.ring_powers` sums them over the segments.
    table : Rings
        Rings of the k plane.
    count : int
        Number of segments.

    Returns
    -------
    array, (rings, n // 2 + 1)
        Degrees of freedom of a cell times the equivalent number of independent cells.

    Notes
    -----
    The variance of sum A_c |F_c|^2 is sum A_c A_d |<F_c F_d*>|^2, and the windows correlate cells c and d by
    rho_cd. With the square of each cell's expected power taken from <|F_c|^4> / 2 (Gaussian waves), the
    number of independent cells is (sum A_c E_c)^2 / sum A_c E_c^2 (rho^2 A)_c: the geometric number of a ring
    for energy spread evenly over it, one for a single wave. Squares are averaged over segments before they
    are summed, so the number does not depend on K.
    """
    power, square = sums[0], sums[1]
    filled = square > 0
    cells = power**2 / (count * (square + ~filled))
    cells = cells * filled + table.cells[:, None] * ~filled  # where there is no energy at all
    return degrees_of_freedom(count) * cells.clip(1)


def ring_variables(table: rings.Rings) -> dict[str, Any]:
    """Variables along k that every E(k, omega) carries: coverage and cells."""
    return {
        "coverage": (
            "k",
            table.coverage,
            {"long_name": "share of the ring inside the sampled plane", "units": "1"},
        ),
        "cells": (
            "k",
            table.cells,
            {
                "long_name": "independent cells of the ring",
                "units": "1",
                "comment": "for energy spread evenly over the ring",
            },
        ),
    }


def komega(
    field: xr.DataArray,
    *,
    segment: int | None = None,
    record: Record | None = None,
    dk: float | None = None,
) -> xr.Dataset:
    """Spectrum E(k, omega): the power spectrum integrated over the angle of the wave vector.

    Parameters
    ----------
    field : DataArray, (time, y, x)
        Any variable of a cube; s and m. Lazy input gives a lazy result, taken in one pass in bounded memory.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs (`find_record`); found from the field if not given, which reads it once more.
    dk : float, optional
        Width of the rings, rad/m; by default 2 pi over the shorter side of the rectangle.

    Returns
    -------
    Dataset
        ``E``, ``dof``, ``low``, ``high``, ``valid`` (omega, k); ``coverage``, ``cells`` (k). The azimuthal
        mean is E / (2 pi k coverage).

    Raises
    ------
    CubeError
        If the record is shorter than a segment, its axes are uneven or no full rectangle is left.

    Notes
    -----
    Each cell of the k plane is shared between rings by area, so energy is conserved to rounding; the corners
    beyond the Nyquist wavenumber of the axes are kept, and ``coverage`` says how much of a ring they fill.
    The degrees of freedom follow from the data (`ring_freedom`): waves from few directions have fewer.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> axes = {"time": np.arange(256) * 0.05, "y": np.arange(24) * 0.05, "x": np.arange(32) * 0.05}
    >>> w = xr.DataArray(rng.standard_normal((256, 24, 32)), axes, ("time", "y", "x"))
    >>> E = komega(w, segment=64)
    >>> E.E.dims, int(E.segments)
    (('omega', 'k'), 7)
    """
    field = _field(field)
    record, segment, count = setting(field, segment, record)
    table = ring_table(record, dk)
    runs = segments.half_segments([field], record, segment // 2, _transform)
    task = dask.delayed(_ring_powers, pure=False)
    shares = table.start, table.ring, table.weight, table.spread
    summed = segments.in_order([task(a, b, *shares) for run in runs for a, b in itertools.pairwise(run)])
    factor = ring_density(record, segment, count, table.dk)
    omega = omega_axis(segment, record.dt)
    sums = da.from_delayed(summed["f"], (2, table.k.size, omega.size), np.float64)
    units = product((field.attrs.get("units", "1"), 2), (K_UNITS, -1), (OMEGA_UNITS, -1))
    name = field.attrs.get("long_name", field.name)
    values = xr.DataArray(
        sums[0].T * factor, dims=("omega", "k"), attrs={"long_name": f"E(k, omega) of {name}", "units": units}
    )
    out = with_interval(values, xr.DataArray(ring_freedom(sums, table, count).T, dims=("omega", "k")))
    out = out.assign(ring_variables(table)).assign_coords(omega_coords(omega) | k_coords(table.k))
    valid = valid_komega(table, omega, record)
    out["valid"] = (("omega", "k"), valid, {"long_name": "where the spectrum can be trusted", "units": "1"})
    return finish(out.assign_attrs(provenance(record, segment, count)), field)


# ---- reductions of spectra ---------------------------------------------------------------------------------
def angular_integral(density: xr.DataArray, dk: float | None = None) -> xr.DataArray:
    """Integrate a density over the plane (ky, kx) along rings of |k|.

    Parameters
    ----------
    density : DataArray, (..., ky, kx)
        A density in rad/m and rad/m, such as ``spectrum(...).E``.
    dk : float, optional
        Width of the rings, rad/m; by default the larger side of a cell.

    Returns
    -------
    DataArray, (..., k)
        Density in rad/m; its sum times dk is the sum of the input times the cell, to rounding.
    """
    ny, nx = density.sizes["ky"], density.sizes["kx"]
    cell_y, cell_x = (float(density[name][1] - density[name][0]) for name in ("ky", "kx"))
    table = rings.rings(ny, nx, 2 * np.pi / (ny * cell_y), 2 * np.pi / (nx * cell_x), dk)

    def integrate(values: np.ndarray) -> np.ndarray:
        flat = np.fft.ifftshift(values, axes=(-2, -1)).reshape(-1, ny * nx).astype(np.float64)
        out = (table.shares.T @ flat.T).T * (cell_y * cell_x / table.dk)
        return out.reshape(*values.shape[:-2], table.k.size)

    out = xr.apply_ufunc(
        integrate,
        density,
        input_core_dims=[["ky", "kx"]],
        output_core_dims=[["k"]],
        dask="parallelized",
        output_dtypes=[np.float64],
        dask_gufunc_kwargs={"output_sizes": {"k": table.k.size}, "allow_rechunk": True},
    )
    out = out.assign_coords(k_coords(table.k))
    out.attrs = {
        "long_name": density.attrs.get("long_name", "density") + ", integrated over angle",
        "units": product((density.attrs.get("units", "1"), 1), (K_UNITS, 1)),
    }
    return out


def at_frequency(density: xr.DataArray, frequency: float, bandwidth: float | None = None) -> xr.DataArray:
    """Cut E(ky, kx) out of E(ky, kx, omega) at a frequency.

    Parameters
    ----------
    density : DataArray, (omega, ...)
        A spectrum.
    frequency : float
        Hz.
    bandwidth : float, optional
        Width of the band that is averaged, Hz; by default the nearest line alone.

    Returns
    -------
    DataArray
        Mean density over the band.

    Raises
    ------
    CubeError
        If the frequency lies beyond the Nyquist frequency.
    """
    lines = density["omega"].values / (2 * np.pi)
    if not 0 <= frequency <= lines[-1]:
        raise CubeError(f"{frequency:g} Hz is outside the spectrum, which ends at {lines[-1]:g} Hz")
    if bandwidth is None:
        chosen = np.array([np.abs(lines - frequency).argmin()])
    else:
        chosen = np.flatnonzero(np.abs(lines - frequency) <= bandwidth / 2 + 1e-9)
        if not chosen.size:
            chosen = np.array([np.abs(lines - frequency).argmin()])
    out = density.isel(omega=chosen).mean("omega")
    out.attrs = dict(density.attrs)
    return out.assign_coords(frequency=float(lines[chosen].mean()))


def frequency_spectrum(komega: xr.Dataset) -> xr.Dataset:
    """Integrate E(k, omega) over k.

    Parameters
    ----------
    komega : Dataset
        As `komega` gives it.

    Returns
    -------
    Dataset
        ``E`` (omega), the mean spectrum over the nodes weighted by the squared window; ``dof``, ``low``,
        ``high`` and ``valid`` (omega).

    Notes
    -----
    The degrees of freedom follow from those of the rings and from the spread of the energy over them.
    """
    step = float(komega["k"][1] - komega["k"][0])
    energy = komega["E"].sum("k", dtype=np.float64) * step
    energy.attrs = {
        "long_name": komega["E"].attrs.get("long_name", "").replace("E(k, omega)", "E(omega)"),
        "units": product((komega["E"].attrs["units"], 1), (K_UNITS, 1)),
    }
    table = rings.rings(*komega.attrs["nodes"], *komega.attrs["node_step"], step)
    single = float(komega.attrs["degrees_of_freedom"])
    dof = single * independent_cells(komega["E"], komega["dof"] / single, table)
    out = with_interval(energy, dof)
    out["valid"] = _valid_omega(komega["omega"])
    out["valid"].attrs = {"long_name": "where the spectrum can be trusted", "units": "1"}
    return out


def independent_cells(energy: xr.DataArray, cells: xr.DataArray, table: rings.Rings) -> xr.DataArray:
    """Independent cells of a sum over rings, (...), from each ring's energy and own cells, (..., k)."""
    share = energy / energy.sum("k")
    # neighbouring rings share cells: correlated as for even energy, with the variance that each has
    share = share * (xr.DataArray(1 / np.diag(table.overlap), dims="k") / cells) ** 0.5
    overlap = xr.DataArray(table.overlap, dims=("k", "k2"))
    norm = xr.dot(
        share, overlap, share.rename(k="k2").drop_vars(["k2", "cycles"], errors="ignore"), dim=["k", "k2"]
    )
    return 1 / norm


def _valid_omega(omega: xr.DataArray) -> xr.DataArray:
    index = np.arange(omega.size)
    return xr.DataArray((index >= _LOWEST) & (index < omega.size - 1), dims="omega")


def with_interval(energy: xr.DataArray, dof: xr.DataArray) -> xr.Dataset:
    """Put a spectrum, its degrees of freedom and its interval together."""
    dof = dof.clip(min=1)
    low, high = (
        xr.apply_ufunc(lambda d, i=i: interval(d)[i], dof, dask="parallelized", output_dtypes=[float])
        for i in (0, 1)
    )
    out = xr.Dataset({"E": energy, "dof": dof, "low": low, "high": high})
    out["dof"].attrs = {"long_name": "degrees of freedom", "units": "1"}
    out["low"].attrs = {"long_name": "lower end of the 95 % interval, factor", "units": "1"}
    out["high"].attrs = {"long_name": "upper end of the 95 % interval, factor", "units": "1"}
    return out
