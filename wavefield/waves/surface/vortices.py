"""Waves and vortices: the horizontal velocity split along and across the wave vector."""

import itertools
from collections.abc import Callable
from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.variables import annotate, validate
from wavefield.waves.estimation import segment_variance, segments, wave_kernels
from wavefield.waves.estimation.degrees_of_freedom import with_interval
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.wave_record import Record
from wavefield.waves.estimation.welch import Welch, k_coords, omega_coords

Array = NDArray[Any]

_PARTS = ("along", "across", "leak")


def _headings(welch: Welch) -> tuple[Array, Array, Array]:
    """Cosine, sine of the wave vector's angle, and the amplitude the window turns across it, (cells, 1).
    Cells of numpy's half plane. Hann windows blur a wave by a third of a cell squared along each axis.
    """
    record = welch.record
    (ny, nx), steps = record.shape, np.array((record.dy, record.dx))
    ky = 2 * np.pi * np.fft.fftfreq(ny, record.dy)[:, None]
    kx = 2 * np.pi * np.fft.rfftfreq(nx, record.dx)[None, :]
    k = np.hypot(ky, kx)
    k[0, 0] = np.inf
    cos, sin = kx / k, ky / k
    cells = 2 * np.pi / (np.array(record.shape) * steps)
    turned = np.minimum(((cos * cells[0]) ** 2 + (sin * cells[1]) ** 2) / (3 * k**2), 1.0)
    return cos.reshape(-1, 1), sin.reshape(-1, 1), np.sqrt(turned).reshape(-1, 1)


def _project(cos: Array, sin: Array) -> Callable[[list[Array], int], dict[str, Array]]:
    """A function that transforms u and v in space and projects them along and across the wave vector."""

    def project(blocks: list[Array], first: int) -> dict[str, Array]:
        v = segments.transform_space(blocks.pop())
        u = segments.transform_space(blocks.pop())
        c, s = cos.astype(u.real.dtype), sin.astype(u.real.dtype)
        return {"along": c * u + s * v, "across": c * v - s * u}

    return project


def _powers(
    a: dict[str, Array], b: dict[str, Array], welch: Welch, turned: Array, begin: int
) -> dict[str, Array]:
    """Powers of one segment, from its two halves, on the rings, and their totals."""
    cells, half = a["along"].shape
    table = welch.table
    shape = int(table.ring.max()) + 1, half + 1
    powers = {name: np.zeros((2, *shape)) for name in _PARTS}
    transform = segments.TimeTransform(half, a["along"].dtype)
    for slab in segments.slabs(cells):
        ring = table.start[slab.start : slab.stop + 1], table.ring, table.weight, table.spread
        for name in ("along", "across"):
            lines = transform(a[name][slab], b[name][slab])
            wave_kernels.ring_powers(lines, *ring, powers[name])
            if name == "along":
                lines *= turned[slab].astype(lines.real.dtype)
                wave_kernels.ring_powers(lines, *ring, powers["leak"])
    out: dict[str, Array] = {}
    for name in _PARTS:
        out[name] = np.zeros_like(powers[name])
        segment_variance.take_in(out, name, powers[name], begin)
    valid = welch.valid.T
    vortices = float((powers["across"][0] - powers["leak"][0])[valid].sum())
    total = float((powers["across"][0] + powers["along"][0])[valid].sum())
    return out | {"totals": np.array([vortices, total, vortices**2, total**2, vortices * total])}


@takes(a_cube)
def waves_and_vortices(
    cube: xr.Dataset, *, segment: int | None = None, record: Record | None = None
) -> xr.Dataset:
    """Split the spectrum of the horizontal velocity into waves and vortices (Helmholtz).

    Parameters
    ----------
    cube : Dataset
        u, v over (time, y, x), m/s. Read once, half a segment at a time; computed at once.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``E_waves``, ``E_vortices``, ``E_leak`` (omega, k), m3 s-1 rad-2: of the velocity along the wave
        vector, of that across it without the part that the windows turn across, and of that part; ``low``,
        ``high``, the factors of the 95 % interval of the velocity across; ``valid``; ``vortical_fraction`` of
        the variance of (u, v) in the valid cells, and its ``_std``.

    Raises
    ------
    CubeError
        If u or v is missing or the record is shorter than a segment.

    Notes
    -----
    u^ = (k k/k^2) . u^ + rest: motion along k has divergence and no vorticity, motion across it the reverse.
    Free waves move along k. The null is an irrotational sea: a Hann window blurs a wave of wave vector k by
    a third of a cell squared along each axis, which turns (cell / k)^2 / 3 of its energy across; this is
    subtracted, to first order, and the uncertainty joins chance (the segment variance) with half of it.
    Velocities are those at the moving surface: its tilt adds to the vorticity of an irrotational sea a part
    of the order of the squared slope, which remains in ``E_vortices``. Mean and trend in time of each wave
    vector are removed, so that a steady swirl does not count.

    Examples
    --------
    Water that moves across the wave vector, then along it.

    >>> axes = {"time": np.arange(128) * 0.05, "y": np.arange(32) * 0.05, "x": np.arange(32) * 0.05}
    >>> series = np.random.default_rng(0).standard_normal((128, 1, 1))
    >>> moving = series * np.cos(12 * axes["y"])[:, None] + 0 * axes["x"]
    >>> at, units = ("time", "y", "x"), {"units": "m s-1"}
    >>> across = xr.Dataset({"u": (at, moving, units), "v": (at, 0 * moving, units)}, axes)
    >>> along = xr.Dataset({"u": (at, 0 * moving, units), "v": (at, moving, units)}, axes)
    >>> parts = [float(waves_and_vortices(one, segment=32).vortical_fraction) for one in (across, along)]
    >>> parts[0] > 0.9, abs(parts[1]) < 0.02
    (True, True)
    """
    fields = validate(cube, "u", "v")
    welch = Welch.of(fields, segment, record)
    cos, sin, turned = _headings(welch)
    runs = segments.half_segments([fields["u"], fields["v"]], welch.record, welch.half, _project(cos, sin))
    task = dask.delayed(_powers, pure=False)
    parts = [
        task(a, b, welch, turned, begin)
        for run, (start, _) in zip(runs, welch.record.runs)
        for begin, (a, b) in zip(itertools.count(start, welch.half), itertools.pairwise(run))
    ]
    sums = segments.in_order(parts).compute()
    dims = ("omega", "k")
    E = {name: sums[name][0].T * welch.ring_density for name in _PARTS}
    dof = segment_variance.freedom(sums, "across", welch, gaussian=False)["both"].T
    interval = with_interval(xr.DataArray(E["across"], dims=dims), xr.DataArray(dof, dims=dims))
    vortices, total, vortices2, total2, product = sums["totals"] / welch.count
    fraction = vortices / total
    # of a ratio of means, from the segment variance
    variance = vortices2 - 2 * fraction * product + fraction**2 * total2
    chance = np.sqrt(max(variance, 0.0) / max(welch.count - 1, 1)) / total
    valid = welch.valid
    correction = 0.5 * float(E["leak"][valid].sum() / (E["along"] + E["across"])[valid].sum())
    out: dict[str, Any] = {
        "E_waves": (dims, E["along"] + E["leak"]),
        "E_vortices": (dims, E["across"] - E["leak"]),
        "E_leak": (dims, E["leak"]),
        "low": interval["low"],
        "high": interval["high"],
        "valid": (dims, valid),
        "vortical_fraction": ((), fraction),
        "vortical_fraction_std": ((), float(np.hypot(chance, correction))),
    }
    coords = omega_coords(welch.omega) | k_coords(welch.table.k)
    return annotate(xr.Dataset(out, coords, welch.attrs), "vortices")
