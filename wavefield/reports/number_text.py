"""Numbers as the pages write them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr


def rms_of(values: xr.DataArray | np.ndarray) -> float:
    """Rms of the finite values; NaN if there are none."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def median_of(values: object) -> float:
    """Median of the finite values; NaN if there are none."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    return float(np.median(finite)) if finite.size else float("nan")


def number(value: float, unit: str = "", digits: int = 3) -> str:
    """A value with its unit, to so many digits; a dash where there is none."""
    if not np.isfinite(value):
        return "–"
    return f"{value:.{digits}g}{' ' + unit if unit else ''}"


def without_folders(value: object, folder: str = "") -> Any:
    """Names of files without the folders of the machine that holds them: a page is for others to read.

    Examples
    --------
    >>> without_folders({"rig": "/data/tank/rig.yaml", "images": ["/data/tank/cam1/a.tif"]}, "/data/tank")
    {'rig': 'rig.yaml', 'images': ['cam1/a.tif']}
    >>> without_folders("/home/me/white.png"), without_folders("m/s")
    ('white.png', 'm/s')
    """
    if isinstance(value, Mapping):
        return {key: without_folders(one, folder) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [without_folders(one, folder) for one in value]
    if not isinstance(value, str) or not Path(value).is_absolute():
        return value
    path = Path(value)
    return path.relative_to(folder).as_posix() if folder and path.is_relative_to(folder) else path.name
