"""Coherence of z_t with w and the nonlinear term at each wave vector."""

from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.variables import annotate
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.segments import Reader
from wavefield.waves.estimation.wave_record import Record
from wavefield.waves.estimation.welch import Welch, k_coords
from wavefield.waves.nonlinear.coherence import NAMES
from wavefield.waves.spectra.cross_spectra import door, moving_welch
from wavefield.waves.spectra.segment_sums import sources, transforms

Array = NDArray[Any]

STEPS_AT_A_TIME = 128


@takes(a_cube)
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
    less the means over time: the equation of Aubourg et al. The modulus of a mean of few samples is never
    zero: N independent ones leave about 0.9 / sqrt(N), which `coherence`, averaged over angle before the
    ratio, does not have.
    """
    cube = door(cube, NAMES)
    welch = Welch.of(cube, None, record)
    (welch,) = dask.compute(moving_welch(cube, welch))
    record, fields = welch.record, sources(NAMES)
    read = Reader([cube[field] for field in fields], record)
    sums: dict[str, Array] = {}
    for run in record.runs:
        for blocks in read.blocks(run, STEPS_AT_A_TIME):
            parts = transforms(dict(zip(fields, blocks)), NAMES, welch)
            for name, values in _sums({n: part.astype(np.complex128) for n, part in parts.items()}).items():
                sums[name] = sums[name] + values if name in sums else values
    steps = sum(b - a for a, b in record.runs)
    ny, nx = record.shape
    kx = 2 * np.pi * np.fft.rfftfreq(nx, record.dx)
    ky = np.fft.fftshift(2 * np.pi * np.fft.fftfreq(ny, record.dy))
    table = welch.table
    ring = np.rint(np.hypot(ky[:, None], kx) / table.dk - table.k[0] / table.dk).astype(int)
    inside = (ring >= 0) & (ring < table.k.size)
    count = np.bincount(ring[inside], minlength=table.k.size)
    out: dict[str, Any] = {}
    for name, values in _coherences({n: part / steps for n, part in sums.items()}).items():
        plane = np.fft.fftshift(values.reshape(ny, nx // 2 + 1), axes=0)
        out[f"plane_C_{name}"] = (("ky", "kx"), plane)
        total = np.bincount(ring[inside], plane[inside], table.k.size)
        mean = np.divide(total, count, out=np.full(count.size, np.nan), where=count > 0)
        out[f"mean_C_{name}"] = ("k", mean)
    coords = {"ky": ky, "kx": kx} | k_coords(table.k)
    return annotate(xr.Dataset(out, coords, {"steps": steps}), "wave_vectors")


def _sums(parts: dict[str, Array]) -> dict[str, Array]:
    """Sums over steps of each term, of their products with z_t and of the powers, (cells,)."""
    z_t, w, nl = (parts[name] for name in NAMES)
    return {
        "z_t": z_t.sum(axis=1),
        "w": w.sum(axis=1),
        "nl": -nl.sum(axis=1),
        "z_t*w": (z_t.conj() * w).sum(axis=1),
        "z_t*nl": -(z_t.conj() * nl).sum(axis=1),
        "power": (np.abs(z_t) ** 2).sum(axis=1),
        "total": (np.abs(w - nl) ** 2).sum(axis=1),
    }


def _coherences(mean: dict[str, Array]) -> dict[str, Array]:
    """Moduli of the coherence of each term and of their sum, (cells,), from the means of `_sums`."""
    power = mean["power"] - np.abs(mean["z_t"]) ** 2
    total = mean["total"] - np.abs(mean["w"] + mean["nl"]) ** 2
    norm = np.sqrt(np.maximum(power * total, 1e-300))
    cross = {n: mean[f"z_t*{n}"] - mean["z_t"].conj() * mean[n] for n in ("w", "nl")}
    cross["tot"] = cross["w"] + cross["nl"]
    return {name: np.abs(values) / norm for name, values in cross.items()}
