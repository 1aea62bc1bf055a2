"""Results that a record is too short for are left out, with a note."""

import numpy as np
import xarray as xr

from wavefield.waves.estimation.record import Record, filled_error
from wavefield.waves.estimation.welch import Welch
from wavefield.waves.products import Noted, WaveProduct, register

FEW_SEGMENTS = 7  # with fewer, single cells of a spectrum are uncertain
MIN_PERIODS = (
    10  # of the strongest wave: fewer do not separate it from its neighbours, nor its height from chance
)
MIN_PERIODS_OF_HEIGHT = 3  # its standard uncertainty is that of a chi-squared value: fewer give no height
MIN_SEGMENTS_FOR_TENSION = 4  # before a fitted surface tension is more than noise
MAX_TENSION_STD = 0.05  # standard uncertainty of the surface tension, relative


def record_notes(welch: Welch, cube: xr.Dataset, depth: float) -> list[str]:
    """Notes on what of a cube was used, and how much it can show."""
    record, count, sizes = welch.record, welch.count, cube.sizes
    used = record.steps_in_runs(welch.segment)
    out = []
    if count < FEW_SEGMENTS:
        out.append(
            f"The record holds {count} segment{'s' if count > 1 else ''} of"
            f" {welch.segment * record.dt:.3g} s: a single cell has {welch.dof:.1f} degrees of freedom,"
            " so trust averages over rings and bands, not single values."
        )
    if used < record.steps:
        out.append(
            f"{record.steps - used} of {record.steps} steps are missing or in pieces too short for a segment."
        )
    if record.bridged:
        out.append(
            f"{len(record.bridged)} missing steps in short gaps were bridged by interpolation in time."
        )
    if record.holes:
        out.append(_note_on_holes(record, cube["z"]))
    if record.shape != (sizes["y"], sizes["x"]):
        out.append(
            f"Of {sizes['y']} x {sizes['x']} nodes (y, x) the largest full rectangle was used,"
            f" {record.shape[0]} x {record.shape[1]}."
        )
    if not np.isfinite(depth):
        out.append("The depth of the water is not known to the cube: deep water was assumed.")
    return out


def _note_on_holes(record: Record, z: xr.DataArray) -> str:
    """How many nodes were filled, how well, and what that adds to the spectrum of the elevation."""
    share = record.holes / (record.steps_in_runs() * record.shape[0] * record.shape[1])
    text = f"{record.holes} missing nodes ({100 * share:.2g} %) were filled from their neighbours"
    error = filled_error(record, z)
    if not np.isfinite(error):
        return f"{text}."
    return (
        f"{text}, with an error of {1e3 * error:.2g} mm (found on nodes that are there): it adds up to"
        f" {2 * record.dt * share * error**2:.1g} m2/Hz to the spectrum of the elevation. Lines with"
        " less than four times that are not valid."
    )


def without_short_peak(statistics: xr.Dataset, seconds: float) -> Noted:
    """Statistics without spectral peak and steepness where the record holds too few of its periods.

    Examples
    --------
    >>> peak = xr.Dataset({"peak_frequency": 1.3, "peak_k": 6.8, "steepness": 0.1})
    >>> without_short_peak(peak, 1.15).notes[0]
    'No spectral peak, no steepness: the record holds 1.5 peak periods (1.15 s); 10 are needed.'
    >>> "steepness" in without_short_peak(peak, 60.0).value
    True
    """
    periods = seconds * float(statistics["peak_frequency"])
    if periods >= MIN_PERIODS:
        return Noted(statistics, [])
    gone = ["peak_frequency", "peak_k", "steepness"]
    notes = [
        f"No spectral peak, no steepness: the record holds {periods:.2g} peak periods ({seconds:.3g} s);"
        f" {MIN_PERIODS} are needed."
    ]
    if not periods >= MIN_PERIODS_OF_HEIGHT:
        gone += ["significant_height"]
        notes.append(
            f"No significant wave height: the record holds {periods:.2g} peak periods;"
            f" {MIN_PERIODS_OF_HEIGHT} are needed."
        )
    gone = [f"{name}{end}" for name in gone for end in ("", "_std")]
    return Noted(statistics.drop_vars(gone, errors="ignore"), notes)


def without_uncertain_tension(fit: xr.Dataset, welch: Welch) -> Noted:
    """A dispersion fit, without its surface tension where that is not determined."""
    if "refused" in fit.attrs:
        return Noted(fit, [f"The dispersion relation was not fitted: {fit.attrs['refused']}."])
    gamma, std = float(fit["gamma"]), float(fit["gamma_std"])
    if welch.count < MIN_SEGMENTS_FOR_TENSION:
        count = welch.count
        reason = f"the record holds {count} segment{'s' if count > 1 else ''}; four are needed"
    elif not np.isfinite(std):
        reason = "the dispersion fit does not determine it"
    elif not std < MAX_TENSION_STD * gamma:
        reason = f"its uncertainty is {1e6 * std:.2g}e-6 of {1e6 * gamma:.2g}e-6 m3/s2"
    else:
        return Noted(fit, [])
    fit = fit.drop_vars(["gamma", "gamma_std", "omega_fit"], errors="ignore")
    return Noted(fit, [f"No surface tension was fitted: {reason}."])


register(
    WaveProduct("dispersion", ("dispersion_fit", "welch"), without_uncertain_tension, group="dispersion")
)
