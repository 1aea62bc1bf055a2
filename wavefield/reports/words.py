"""Numbers as the pages write them."""

import numpy as np
import xarray as xr


def rms_of(values: xr.DataArray | np.ndarray) -> float:
    """Rms of the finite values; NaN if there are none."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def number(value: float, unit: str = "", digits: int = 3) -> str:
    """A value with its unit, to so many digits; a dash where there is none."""
    if not np.isfinite(value):
        return "–"
    return f"{value:.{digits}g}{' ' + unit if unit else ''}"
