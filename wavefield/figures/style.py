"""What all figures share: sizes, colours, and how a field is drawn as a map.

Colour maps: red-blue, balanced about zero, for signed fields; cividis for positive ones. Both keep their
order for colour-blind readers. Lines differ by dash as well as by colour.
"""

import io
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

SIGNED, POSITIVE = "RdBu_r", "cividis"

# Okabe and Ito's colours that stand out from white, each with its own dash
LINES: tuple[dict[str, Any], ...] = (
    {"color": "#000000", "linestyle": "-"},
    {"color": "#0072B2", "linestyle": "-"},
    {"color": "#D55E00", "linestyle": "--"},
    {"color": "#009E73", "linestyle": "-."},
    {"color": "#CC79A7", "linestyle": (0, (1, 1))},
    {"color": "#7A5195", "linestyle": (0, (5, 1, 1, 1, 1, 1))},
)

_RC: Any = {
    "font.size": 10.5,
    "axes.titlesize": 11,
    "axes.labelsize": 10.5,
    "axes.grid": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": "white",
}


class _Shown(Figure):
    """A figure that a notebook shows by itself, whatever its backend."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


def panels(columns: int, rows: int = 1, *, width: float = 5.2, height: float = 4.1) -> tuple[Figure, Any]:
    """Make a figure with panels, without any global state.

    Returns axes (rows, columns).
    """
    with matplotlib.rc_context(_RC):
        figure = _Shown(figsize=(width * columns, height * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
    return figure, axes


def map_panels(field: xr.DataArray, columns: int, rows: int = 1, *, width: float = 5.2) -> tuple[Figure, Any]:
    """Make a figure with panels of the shape of a field's rectangle.

    With field (y, x); returns axes (rows, columns).
    """
    wide, high = (float(np.ptp(field[d].values)) or 1.0 for d in ("x", "y"))
    height = float(np.clip(0.74 * width * high / wide + 0.85, 1.6, 1.5 * width))
    return panels(columns, rows, width=width, height=height)


def panel_3d(*, width: float = 7.2, height: float = 4.8) -> tuple[Figure, Any]:
    """Make a figure with one three-dimensional panel."""
    with matplotlib.rc_context(_RC):
        figure = _Shown(figsize=(width, height), layout="constrained")
        axes = figure.add_subplot(projection="3d")
    return figure, axes


def edges(centres: np.ndarray) -> np.ndarray:
    """Edges of the cells around equally spaced centres.

    With centres (n,); returns (n + 1,).

    Examples
    --------
    >>> edges(np.array([0.0, 1.0, 2.0])).tolist()
    [-0.5, 0.5, 1.5, 2.5]
    """
    centres = np.asarray(centres, float)
    step = (centres[-1] - centres[0]) / max(len(centres) - 1, 1) or 1.0
    return np.concatenate([centres - step / 2, centres[-1:] + step / 2])


def limit(values: Any, percent: float = 99.5) -> float:
    """Half-width of a balanced colour scale."""
    finite = np.abs(np.asarray(values, float))
    finite = finite[np.isfinite(finite)]
    return float(np.percentile(finite, percent)) or 1e-9 if finite.size else 1.0


def draw_map(
    axes: Axes,
    field: xr.DataArray,
    label: str,
    *,
    factor: float = 1.0,
    cmap: str = SIGNED,
    scale: tuple[float, float] | None = None,
    title: str = "",
) -> Any:
    """Draw a field over the physical plane, with its colour bar.

    With field (y, x).
    """
    values = factor * np.asarray(field.transpose("y", "x").values, float)
    if scale is None:
        half = limit(values)
        scale = (-half, half)
    axes.set_facecolor("0.85")
    mesh = axes.pcolormesh(
        edges(field.x.values),
        edges(field.y.values),
        np.ma.masked_invalid(values),
        cmap=cmap,
        vmin=scale[0],
        vmax=scale[1],
        rasterized=True,
    )
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=title)
    beyond = "neither" if scale == (0, 100) else "max" if scale[0] == 0 else "both"
    colour_bar(axes, mesh, label, beyond)
    return mesh


def colour_bar(axes: Axes, drawn: Any, label: str, extend: str = "both") -> None:
    """Put a colour bar beside a panel, as high as the panel."""
    bar = axes.inset_axes((1.025, 0.0, 0.035, 1.0))
    axes.figure.colorbar(drawn, cax=bar, label=label, extend=extend)


def moment_title(snapshot: xr.Dataset) -> str:
    """Time of a snapshot, for a title."""
    return f"t = {round(float(snapshot.time), 3):g} s" if "time" in snapshot.coords else ""


def plain_axes(axes: Axes, **legend: Any) -> None:
    """Give a line plot a light grid, and its legend if it has named lines."""
    axes.grid(True, which="major", color="0.88", linewidth=0.7)
    axes.set_axisbelow(True)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(**{"frameon": False, "fontsize": 9} | legend)


def densities(values: Sequence[float] | np.ndarray, bins: np.ndarray) -> np.ndarray:
    """Probability density of values in bins.

    With bins (n + 1,); returns (n,): Density, per unit of the values.
    """
    finite = np.asarray(values, float).ravel()
    finite = finite[np.isfinite(finite)]
    counts, _ = np.histogram(finite, bins)
    out: np.ndarray = counts / (max(finite.size, 1) * np.diff(bins))
    return out
