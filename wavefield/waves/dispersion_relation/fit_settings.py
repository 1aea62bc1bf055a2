"""Settings of the dispersion fit, and how a user states them."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from wavefield.errors import CubeError

_CURRENT_NAMES = ("current_x", "current_y")


@dataclass(frozen=True)
class FitSettings:
    """Band of the dispersion fit, and the window in which it measures centroids.

    Parameters
    ----------
    lowest, highest : float, optional
        Band of frequencies used, Hz, and higher ones of waves that a current carries past faster. If not
        given, all that the spectrum resolves, each line weighted by how far its waves exceed the noise. Waves
        longer than two fifths of the shorter side of the rectangle are always left out.
    sectors : int
        Sectors of angle.
    half_width : float
        Half width of the window around the relation, relative to k.
    least_width : float
        Its lower bound in cells of the k plane: a Hann window spreads a wave over two on either side.
    rounds : int
        How often the window is centred on the fit again.
    """

    lowest: float | None = None
    highest: float | None = None
    sectors: int = 24
    half_width: float = 0.22
    least_width: float = 2.2
    rounds: int = 4


def fit_settings(
    fit: FitSettings | Mapping[str, Any] | None,
) -> tuple[FitSettings, tuple[float, float] | None]:
    """Settings of the fit, and the current in m/s to use where it is refused, from what a user gives.

    Examples
    --------
    >>> fit_settings({"lowest": "1", "current_x": 0.1})[1]
    (0.1, 0.0)
    """
    if fit is None or isinstance(fit, FitSettings):
        return fit or FitSettings(), None
    kinds = {field.name: field.type for field in fields(FitSettings)}
    kinds |= dict.fromkeys(_CURRENT_NAMES, "float")
    values: dict[str, Any] = {}
    for name, value in fit.items():
        if name not in kinds:
            raise CubeError(f"`fit` has no setting {name!r}; it has {', '.join(kinds)}")
        try:
            values[name] = int(value) if kinds[name] is int else float(value)
        except (TypeError, ValueError):
            raise CubeError(f"`fit` needs a number for {name}, not {value!r}") from None
        if not np.isfinite(values[name]) or (name not in _CURRENT_NAMES and values[name] <= 0):
            raise CubeError(f"`fit` needs a positive number for {name}, not {value!r}")
    if values.get("lowest", 0.0) >= values.get("highest", np.inf):
        raise CubeError(
            f"`fit` needs lowest below highest, not {values['lowest']:g} and {values['highest']:g}"
        )
    given = [values.pop(name, None) for name in _CURRENT_NAMES]
    current = None if given == [None, None] else (given[0] or 0.0, given[1] or 0.0)
    return FitSettings(**values), current
