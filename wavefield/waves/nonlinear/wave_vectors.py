"""Coherence of z_t with w and the nonlinear term at each wave vector, as the paper prints it."""

from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.variables import annotate
from wavefield.waves.estimation.segments import Reader
from wavefield.waves.estimation.wave_record import Record
from wavefield.waves.estimation.welch import Welch, k_coords
from wavefield.waves.nonlinear.coherence import NAMES
from wavefield.waves.spectra.cross_spectra import door, moving_welch, sources, transforms

Array = NDArray[Any]

_PIECE = 128  # steps taken in at a time


def plane_coherence(cube: xr.Dataset, *, record: Record | None = None) -> xr.Dataset:
    """Coherence at each wave vector, averaged over time, and its mean over angle taken after the ratio.

    Parameters
    ----------
    cube : Dataset
        z, z_t, u, v, w over (time, y, x), m and m/s. Read once, in pieces; computed at once.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``plane_C_w``, ``plane_C_nl``, ``plane_C_tot`` (ky, kx), moduli, for kx >= 0 (a real field has the
        same at -k), and their means over rings ``mean_C_w`` ... (k). Attribute ``steps``.

    Raises
    ------
    CubeError
        If a variable is missing or no full rectangle is left.

    Notes
    -----
    |<conj(z_t) a>| / sqrt(<|z_t|^2> <|w - u . grad z|^2>) of Hann-windowed transforms in space, <> over time,
    means over time taken off: the paper's equation. The modulus of a mean of few samples is never zero: N
    independent ones leave about .9 / sqrt(N), which `coherence`, averaged over angle before the ratio,
    does not have.
    """
    cube = door(cube, NAMES)
    welch = Welch.of(cube, None, record)
    (welch,) = dask.compute(moving_welch(cube, welch))
    record, fields = welch.record, sources(NAMES)
    read = Reader([cube[field] for field in fields], record)
    sums: dict[str, Array] = {}
    steps = 0
    for run in record.runs:
        for a in range(run[0], run[1], _PIECE):
            b = min(a + _PIECE, run[1])
            given = dict(zip(fields, read(a, b, run)))
            parts = transforms(given, NAMES, welch)
            _take_in(sums, {name: part.astype(np.complex128) for name, part in parts.items()})
            steps += b - a
    found = _ratios(sums, steps)
    ny, nx = record.shape
    plane = {n: np.fft.fftshift(c.reshape(ny, nx // 2 + 1), axes=0) for n, c in found.items()}
    kx = 2 * np.pi * np.fft.rfftfreq(nx, record.dx)
    ky = np.fft.fftshift(2 * np.pi * np.fft.fftfreq(ny, record.dy))
    table = welch.table
    ring = np.rint(np.hypot(ky[:, None], kx) / table.dk - table.k[0] / table.dk).astype(int)
    out: dict[str, Any] = {}
    for name, values in plane.items():
        out[f"plane_C_{name}"] = (("ky", "kx"), values)
        inside = (ring >= 0) & (ring < table.k.size)
        total = np.bincount(ring[inside], values[inside], table.k.size)
        count = np.bincount(ring[inside], minlength=table.k.size)
        out[f"mean_C_{name}"] = (
            "k",
            np.divide(total, count, out=np.full(count.size, np.nan), where=count > 0),
        )
    coords = {"ky": ky, "kx": kx} | k_coords(table.k)
    return annotate(xr.Dataset(out, coords, {"steps": steps}), "wave_vectors")


def _take_in(sums: dict[str, Array], parts: dict[str, Array]) -> None:
    # (cells,) sums of each term, of their products with z_t and of the powers
    z_t, w, nl = (parts[name] for name in NAMES)
    total = w - nl
    new = {
        "z_t": z_t.sum(axis=1),
        "w": w.sum(axis=1),
        "nl": -nl.sum(axis=1),
        "z_t*w": (z_t.conj() * w).sum(axis=1),
        "z_t*nl": -(z_t.conj() * nl).sum(axis=1),
        "power": (np.abs(z_t) ** 2).sum(axis=1),
        "total": (np.abs(total) ** 2).sum(axis=1),
    }
    for name, values in new.items():
        sums[name] = sums[name] + values if name in sums else values


def _ratios(sums: dict[str, Array], steps: int) -> dict[str, Array]:
    mean = {name: sums[name] / steps for name in ("z_t", "w", "nl")}
    power = sums["power"] / steps - np.abs(mean["z_t"]) ** 2
    total = sums["total"] / steps - np.abs(mean["w"] + mean["nl"]) ** 2
    norm = np.sqrt(np.maximum(power * total, 1e-300))
    cross = {n: sums[f"z_t*{n}"] / steps - mean["z_t"].conj() * mean[n] for n in ("w", "nl")}
    cross["tot"] = cross["w"] + cross["nl"]
    return {name: np.abs(values) / norm for name, values in cross.items()}
