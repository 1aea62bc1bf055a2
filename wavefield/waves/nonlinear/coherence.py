"""Coherence of the rate of rise with the vertical velocity and the nonlinear term."""

from typing import Any

import numpy as np
import xarray as xr

from wavefield.variables import annotate
from wavefield.waves.estimation.inputs import a_cube, takes
from wavefield.waves.estimation.wave_record import Record
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.products import Product, register
from wavefield.waves.spectra.cross_spectra import door, lazy_cross_spectra
from wavefield.waves.spectra.field_spectra import finish

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


register(Product("coherence", ("ring",), from_spectra, group="coherence", pairs=PAIRS))
