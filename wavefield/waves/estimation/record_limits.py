"""What a record is too short to say is not said."""

import numpy as np
import xarray as xr

_PERIODS = 10  # of a wave: fewer do not tell it from its neighbours, nor its height from chance
_SEGMENTS = 4  # independent ones, before a fitted surface tension is more than their noise
_SPREAD = 0.05  # of the surface tension: its uncertainty must be less

Groups = tuple[xr.Dataset, xr.Dataset, list[str]]


def leave_out_unknown(
    statistics: xr.Dataset, dispersion: xr.Dataset, seconds: float, segments: int
) -> Groups:
    """Take away what a record does not last long enough for.

    Examples
    --------
    >>> peak = xr.Dataset({"peak_frequency": 1.3, "peak_k": 6.8, "steepness": 0.1})
    >>> leave_out_unknown(peak, xr.Dataset(), 1.15, 1)[2][0]
    'No spectral peak, no steepness: the record lasts 1.15 s, 1.5 periods of its strongest wave (of ten).'
    >>> "steepness" in leave_out_unknown(peak, xr.Dataset(), 60.0, 9)[0]
    True
    """
    notes = []
    periods = seconds * float(statistics["peak_frequency"])
    if periods < _PERIODS:
        statistics = statistics.drop_vars(["peak_frequency", "peak_k", "steepness"])
        notes.append(
            f"No spectral peak, no steepness: the record lasts {seconds:.3g} s, {periods:.2g} periods of its "
            "strongest wave (of ten)."
        )
    if "gamma" in dispersion:
        fitted, spread = float(dispersion["gamma"]), float(dispersion["gamma_std"])
        why = ""
        if segments < _SEGMENTS:
            why = f"the record holds {segments} segment{'s' if segments > 1 else ''}; four are needed"
        elif not np.isfinite(spread):
            why = "the ridge does not tell it"
        elif not spread < _SPREAD * fitted:
            why = f"its uncertainty is {1e6 * spread:.2g}e-6 of {1e6 * fitted:.2g}e-6 m3/s2"
        if why:
            dispersion = dispersion.drop_vars(["gamma", "gamma_std", "omega_fit"], errors="ignore")
            notes.append(f"No surface tension was fitted: {why}.")
    return statistics, dispersion, notes
