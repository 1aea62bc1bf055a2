"""Which current an estimate used, and its origin."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from wavefield.waves.products import Product, register

FITTED, GIVEN, NO_CURRENT = "fit", "given", "none"


@dataclass(frozen=True)
class CurrentUsed:
    """A current and its origin."""

    velocity: tuple[float, float]  # along x and y, m/s
    std: tuple[float, float]  # standard uncertainty, m/s; NaN where it was not estimated
    source: str  # ``fit``, ``given``, or ``none`` where still water is assumed
    reason: str = ""  # why the fit was refused

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes of a product that used it."""
        out = {"current": list(self.velocity), "current_std": list(self.std), "current_source": self.source}
        return out | ({"current_fit_refused": self.reason} if self.reason else {})


def current_used(dispersion: xr.Dataset, given: tuple[float, float] | None) -> CurrentUsed:
    """The fitted current of a dispersion group, else the given one, m/s, else none."""
    if "current_x" in dispersion:
        velocity, std = ([float(dispersion[f"current_{a}{end}"]) for a in "xy"] for end in ("", "_std"))
        return CurrentUsed((velocity[0], velocity[1]), (std[0], std[1]), FITTED)
    reason = str(dispersion.attrs.get("refused", ""))
    return CurrentUsed(given or (0.0, 0.0), (np.nan, np.nan), GIVEN if given else NO_CURRENT, reason)


def _current(dispersion: xr.Dataset, fit_settings: tuple[object, tuple[float, float] | None]) -> CurrentUsed:
    return current_used(dispersion, fit_settings[1])


def _fitted_or_given(current: CurrentUsed) -> CurrentUsed | None:
    return None if current.source == NO_CURRENT else current


def _fitted(current: CurrentUsed) -> CurrentUsed | None:
    return current if current.source == FITTED else None


register(
    Product("current", ("dispersion_fit", "fit_settings"), _current),
    Product("fitted_or_given_current", ("current",), _fitted_or_given),
    Product("fitted_current", ("current",), _fitted),
)
