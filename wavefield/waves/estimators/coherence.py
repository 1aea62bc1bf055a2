"""Coherence of z_t with w and the nonlinear term at each wave vector."""

from typing import Any

import dask
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.variables import annotate
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.record import Record
from wavefield.waves.estimation.segments import Reader
from wavefield.waves.estimation.welch import Welch, k_coords
from wavefield.waves.estimators.cross_spectra import (
    door,
    lazy_cross_spectra,
    moving_welch,
    sources,
    transforms,
)
from wavefield.waves.estimators.field_spectra import finish
from wavefield.waves.products import WaveProduct, register

NAMES = ("rise", "w", "nl")
MIN_SIGNAL_TO_NOISE = 2.0  # of the energy of a ring over that of its noise
PAIRS = (("rise", "w"), ("rise", "nl"), ("w", "nl"))


def significance_level(samples: float | np.ndarray, chance: float = 0.05) -> Any:
    """Coherence squared that unrelated signals exceed by chance, 1 - chance^(1 / (N - 1))."""
    more = np.maximum(samples - 1, 1e-9)
    return 1 - chance ** (1 / more)


def _above_noise(energy: xr.DataArray) -> xr.DataArray:
    """Rings (k,) whose energy (omega, k) exceeds their noise: waves are on few of a ring's lines."""
    noise = energy.median("omega") * energy.sizes["omega"]
    return energy.sum("omega") > MIN_SIGNAL_TO_NOISE * noise


def from_spectra(ring: xr.Dataset) -> xr.Dataset:
    """Coherences over k and over (k, omega) from the cross spectra of z_t, w and u . grad z."""
    total = ring["E_w"] + ring["E_nl"] - 2 * ring["S_w_nl"].real
    # cross spectrum with z_t and power of each term; the nonlinear term is -u . grad z
    terms = {
        "w": (ring["S_rise_w"], ring["E_w"]),
        "nl": (-ring["S_rise_nl"], ring["E_nl"]),
        "tot": (ring["S_rise_w"] - ring["S_rise_nl"], total),
    }
    rise = ring["E_rise"]
    over_k = {name: (cross.sum("omega"), power.sum("omega")) for name, (cross, power) in terms.items()}
    out: dict[str, Any] = {}
    for ending, sums, rise_power in (("", over_k, rise.sum("omega")), ("_komega", terms, rise)):
        norm = np.sqrt(rise_power * sums["tot"][1])
        for name, (cross, power) in sums.items():
            out[f"C_{name}{ending}"] = cross / norm
            both = rise_power * power
            out[f"gamma2_{name}{ending}"] = np.abs(cross) ** 2 / both.where(both > 0)
            # the sum w - u . grad z has those of w, its largest part
            pair = "rise_nl" if name == "nl" else "rise_w"
            samples = ring[f"samples_{pair}" if ending else f"samples_k_{pair}"]
            samples = samples.clip(min=1)
            out[f"samples_{name}{ending}"] = samples
            out[f"bias_{name}{ending}"] = 1 / samples
            out[f"level_{name}{ending}"] = xr.apply_ufunc(
                significance_level, samples, dask="parallelized", output_dtypes=[float]
            )
    # noise of z_t and w comes from the same images, and is coherent
    out["valid"] = _above_noise(rise) & _above_noise(ring["E_w"]) & ring["valid"].any("omega")
    return annotate(xr.Dataset(out, attrs=ring.attrs), "coherence")


@takes(a_cube)
def coherence(cube: xr.Dataset, *, segment: int | None = None, record: Record | None = None) -> xr.Dataset:
    """Coherence of z_t with w, with -u . grad z and with their sum, over k and over (k, omega).

    Parameters
    ----------
    cube : Dataset
        z, z_t, u, v, w over (time, y, x), m and m/s. Lazy input gives a lazy result.
    segment : int, optional
        Steps of a Welch segment; chosen from the record if not given.
    record : Record, optional
        Rectangle and runs; found from the cube if not given.

    Returns
    -------
    Dataset
        ``C_w``, ``C_nl``, ``C_tot`` (k), complex; ``gamma2_w``, ``samples_w``, ``bias_w``, ``level_w`` and
        likewise ``nl``, ``tot`` (k); the same with ``_komega`` over (omega, k). ``valid`` (k): where the
        waves exceed the noise, which is coherent too.

    Raises
    ------
    CubeError
        If a variable is missing, the record is shorter than a segment or no full rectangle is left.

    Notes
    -----
    All are in the frame that moves with the mean current U, the mean of u, v over the record: z_t is
    z_t + U . grad z, and u is u - U, since U . grad z is linear.
    The three C share the norm sqrt(<|z_t|^2> <|w - u . grad z|^2>), cross and auto spectra being averaged
    over angle first, so C_w + C_nl = C_tot exactly and |C_w| may exceed 1. Sums run over omega >= 0, where k
    points where the wave goes; the mean over both signs of omega is the real part. gamma2 is the standard
    coherence; for unrelated signals its mean is 1 / samples.

    Examples
    --------
    A plane tilted by 0.1 that water crosses at a tenth of its rate of rise.

    >>> rise = np.random.default_rng(0).standard_normal((128, 20, 24))
    >>> axes = {"time": np.arange(128) * 0.05, "y": np.arange(20) * 0.04, "x": np.arange(24) * 0.04}
    >>> fields = {"z_t": rise, "u": 0.1 * rise, "v": 0 * rise, "w": 1.01 * rise}
    >>> fields["z"] = 0 * rise + 0.1 * axes["x"]
    >>> units = {"z": {"units": "m"}} | {name: {"units": "m s-1"} for name in ("z_t", "u", "v", "w")}
    >>> at = ("time", "y", "x")
    >>> cube = xr.Dataset({name: (at, field, units[name]) for name, field in fields.items()}, axes)
    >>> C = coherence(cube, segment=32)
    >>> print(f"{float(C.gamma2_w.min()):.2f}, {float(abs(C.C_w).max()):.2f}, {float(abs(C.C_nl).max()):.2f}")
    1.00, 1.01, 0.01
    """
    cube = door(cube, NAMES)
    ring = lazy_cross_spectra(cube, NAMES, PAIRS, Welch.of(cube, segment, record))
    return finish(from_spectra(ring), cube["z_t"])


register(WaveProduct("coherence", ("ring",), from_spectra, group="coherence", pairs=PAIRS))


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
