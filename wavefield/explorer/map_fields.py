"""Maps for the eye: what is drawn of one step, its colours, its arrows, its relief. Arrays in, arrays out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.figures.style import POSITIVE, SIGNED, limit
from wavefield.waves.nonlinear.kinematics import kinematics

DERIVED = {
    "vorticity": ("vertical vorticity of the surface", "s-1"),
    "divergence": ("divergence of the surface velocity", "s-1"),
    "residual": ("kinematic residual z_t - w + u . grad z", "m s-1"),
}
_BALANCE = ("z", "z_t", "u", "v", "w")


def derive(steps: xr.Dataset, name: str, step: int) -> NDArray[Any]:
    """A derived field at one step.

    With steps (time, y, x); returns (ny, nx).
    """
    return np.asarray(kinematics(steps[list(_BALANCE)])[name].values[step])


def is_signed(name: str) -> bool:
    """Whether a variable has a sign, so that its colours are balanced about zero."""
    return not name.endswith("_std") and name not in ("eps_piv", "quality")


def colour_map(name: str) -> str:
    """Colour map of a variable, whose order colour-blind readers keep."""
    return SIGNED if is_signed(name) else POSITIVE


def palette(name: str) -> list[str]:
    """256 colours of a matplotlib colour map."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colour) for colour in colormaps[name](np.linspace(0, 1, 256))]


def colour_limits(values: NDArray[Any], name: str) -> tuple[float, float]:
    """Ends of a colour scale that leave out the wildest half percent."""
    half = float(f"{limit(values):.2g}")
    return (-half, half) if is_signed(name) else (0.0, half)


@dataclass(frozen=True)
class Shown:
    """How a variable is shown to people."""

    factor: float  # From the stored unit to the shown one
    unit: str  # The shown unit

    @property
    def suffix(self) -> str:
        """The unit in brackets, after a space; nothing for pure numbers."""
        return f" ({self.unit})" if self.unit else ""


_UNITS = {
    "m": Shown(100.0, "cm"),
    "m s-1": Shown(100.0, "cm/s"),
    "s-1": Shown(1.0, "1/s"),
    "1": Shown(1.0, ""),
    "pixel": Shown(1.0, "px"),
}
_SMALL = Shown(1000.0, "mm")


def shown_as(name: str, units: str) -> Shown:
    """Unit in which a variable is read with ease.

    Examples
    --------
    >>> shown_as("z", "m"), shown_as("z_std", "m").unit
    (Shown(factor=100.0, unit='cm'), 'mm')
    """
    if units == "m" and name != "z":
        return _SMALL
    return _UNITS.get(units, Shown(1.0, units))


def arrows(
    u: NDArray[Any], v: NDArray[Any], x: NDArray[Any], y: NDArray[Any], fastest: float, *, along: int = 24
) -> tuple[NDArray[Any], NDArray[Any], float]:
    """Arrows of the horizontal velocity at every so-many-th node.

    With u, v (ny, nx); x, y (nx,), metres; returns xs, ys (7 n,): n arrows in one line, metres: shaft and
    head in six points, and NaN where the pen is lifted.
    """
    every = max(1, round(max(len(x), len(y)) / along))
    rows, columns = slice(every // 2, None, every), slice(every // 2, None, every)
    gap = every * float(np.mean(np.diff(x)))
    metres = 1.2 * gap / fastest if fastest > 0 else 0.0
    px, py = np.meshgrid(x[columns], y[rows])
    dx, dy = metres * u[rows, columns], metres * v[rows, columns]
    there = np.isfinite(dx) & np.isfinite(dy) & (np.hypot(dx, dy) > 0.04 * gap)
    px, py, dx, dy = (part[there] for part in (px, py, dx, dy))
    head = 0.32
    xs = [px, px + dx, px + dx - head * (dx - 0.5 * dy), px + dx, px + dx - head * (dx + 0.5 * dy), px + dx]
    ys = [py, py + dy, py + dy - head * (dy + 0.5 * dx), py + dy, py + dy - head * (dy - 0.5 * dx), py + dy]
    lifted = np.full_like(px, np.nan)
    return np.array([*xs, lifted]).T.ravel(), np.array([*ys, lifted]).T.ravel(), metres


def relief(
    field: NDArray[Any], x: NDArray[Any], y: NDArray[Any], most: int = 80
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """A field thinned for the relief.

    With field (ny, nx); x, y (nx,).
    """
    every = max(1, -(-max(field.shape) // most))
    return field[::every, ::every], x[::every], y[::every]


def readings(values: Mapping[str, float], units: Mapping[str, str], names: Sequence[str]) -> str:
    """Values at a node in words."""
    words = []
    for name in names:
        shown = shown_as(name, units[name])
        value = values[name] * shown.factor
        text = f"{value:.3g}".replace("-", "\u2212") if np.isfinite(value) else "none"
        words.append(f"{name} {text}" + (f" {shown.unit}" if shown.unit and np.isfinite(value) else ""))
    return ", ".join(words)
