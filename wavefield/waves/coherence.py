"""Coherence of the rate of rise with vertical velocity and nonlinear term: the paper's three curves."""

from typing import Any

import numpy as np
import xarray as xr

from wavefield.variables import annotate
from wavefield.waves import rings
from wavefield.waves.crosses import door, lazy_cross_spectra
from wavefield.waves.record import Record
from wavefield.waves.spectra import finish
from wavefield.waves.welch import Welch
from wavefield.waves.windows import effective_duration

NAMES = ("z_t", "w", "nl")
PAIRS = (("z_t", "w"), ("z_t", "nl"), ("w", "nl"))


def significance_level(samples: Any, chance: float = 0.05) -> Any:
    """Coherence squared that unrelated signals exceed by chance, 1 - chance^(1 / (N - 1)).

    Parameters
    ----------
    samples : array_like
        Effective number of independent samples N.
    chance : float
        Probability.

    Returns
    -------
    array_like
        Level, 0 to 1; 1 where there is but one sample.

    Examples
    --------
    >>> round(float(significance_level(45.0)), 3)
    0.066
    """
    more = np.maximum(samples - 1, 1e-9)
    return 1 - chance ** (1 / more)


def samples_in_time(energy: xr.DataArray, duration: float, cells: xr.DataArray | float = 1.0) -> xr.DataArray:
    """Effective number of independent samples of a record in time, (sum S)^2 / sum S^2.

    Parameters
    ----------
    energy : DataArray, (omega, ...)
        Spectrum, one-sided.
    duration : float
        Length of the record, s (`effective_duration` for an estimate from windowed segments).
    cells : DataArray, (omega, ...), optional
        Independent samples in space at each frequency.

    Returns
    -------
    DataArray
        T (int S domega)^2 / (2 pi int S^2 / cells domega): a narrow band repeats itself, so this is far less
        than the number of steps.
    """
    step = float(energy["omega"][1] - energy["omega"][0])
    return duration * step * energy.sum("omega") ** 2 / (2 * np.pi * (energy**2 / cells).sum("omega"))


def _terms(ring: xr.Dataset) -> dict[str, tuple[xr.DataArray, xr.DataArray]]:
    # cross spectrum with z_t and power of each term; -u . grad z, so signs turn
    total = ring["E_w"] + ring["E_nl"] - 2 * ring["S_w_nl"].real
    return {
        "w": (ring["S_z_t_w"], ring["E_w"]),
        "nl": (-ring["S_z_t_nl"], ring["E_nl"]),
        "tot": (ring["S_z_t_w"] - ring["S_z_t_nl"], total),
    }


def from_spectra(ring: xr.Dataset) -> xr.Dataset:
    """Coherences from the cross spectra of z_t, w and u . grad z.

    Parameters
    ----------
    ring : Dataset
        As `cross_spectra` gives it for `NAMES` and `PAIRS`.

    Returns
    -------
    Dataset
        As `coherence` gives it.
    """
    samples_k_omega = ring.attrs["degrees_of_freedom"] / 2 * ring["cells"]
    duration = effective_duration(ring.attrs["segments"], ring.attrs["segment"] * ring.attrs["dt"])
    table = rings.rings(*ring.attrs["nodes"], *ring.attrs["node_step"], float(ring["k"][1] - ring["k"][0]))
    in_time = samples_in_time((ring["E_z_t"] * ring["E_w"]) ** 0.5, duration)
    samples_k = (in_time * xr.DataArray(table.cells, dims="k")).clip(min=1)

    out = {}
    for ending, over in (("", "omega"), ("_komega", None)):
        add = (lambda array: array.sum("omega")) if over else (lambda array: array)
        total = _terms(ring)["tot"][1]
        norm = np.sqrt(add(ring["E_z_t"]) * add(total))
        for name, (cross, power) in _terms(ring).items():
            out[f"C_{name}{ending}"] = add(cross) / norm
            out[f"gamma2_{name}{ending}"] = np.abs(add(cross)) ** 2 / (add(ring["E_z_t"]) * add(power))
        samples = samples_k if over else samples_k_omega
        out[f"samples{ending}"] = samples
        out[f"bias{ending}"] = 1 / samples
        out[f"level{ending}"] = xr.apply_ufunc(
            significance_level, samples, dask="parallelized", output_dtypes=[float]
        )
    return annotate(xr.Dataset(out, attrs=ring.attrs), "coherence")


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
        ``C_w``, ``C_nl``, ``C_tot`` (k), complex; ``gamma2_w``, ``gamma2_nl``, ``gamma2_tot``, ``samples``,
        ``bias``, ``level`` (k); the same with ``_komega`` over (omega, k).

    Raises
    ------
    CubeError
        If a variable is missing, the record is shorter than a segment or no full rectangle is left.

    Notes
    -----
    The three C share the norm sqrt(<|z_t|^2> <|w - u . grad z|^2>), cross and auto spectra being averaged
    over angle first, so C_w + C_nl = C_tot exactly and |C_w| may exceed 1. Sums run over omega > 0, where k
    points where the wave goes; the mean over both signs of omega is the real part. gamma2 is the standard
    coherence; for unrelated signals its mean is 1 / samples.
    """
    cube = door(cube, NAMES)
    ring = lazy_cross_spectra(cube, NAMES, PAIRS, Welch.of(cube, segment, record))
    return finish(from_spectra(ring), cube["z_t"])
