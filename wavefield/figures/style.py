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

    Parameters
    ----------
    columns, rows : int
        Number of panels.
    width, height : float
        Of one panel, inches.

    Returns
    -------
    figure : Figure
    axes : ndarray of Axes, (rows, columns)
    """
    with matplotlib.rc_context(_RC):
        figure = _Shown(figsize=(width * columns, height * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
    return figure, axes


def map_panels(field: xr.DataArray, columns: int, rows: int = 1, *, width: float = 5.2) -> tuple[Figure, Any]:
    """Make a figure with panels of the shape of a field's rectangle.

    Parameters
    ----------
    field : DataArray, (y, x) or more
        What will be drawn.
    columns, rows : int
        Number of panels.
    width : float
        Of one panel, inches.

    Returns
    -------
    figure : Figure
    axes : ndarray of Axes, (rows, columns)
    """
    wide, high = (float(np.ptp(field[d].values)) or 1.0 for d in ("x", "y"))
    height = float(np.clip(0.74 * width * high / wide + 0.85, 1.6, 1.5 * width))
    return panels(columns, rows, width=width, height=height)


def panel_3d(*, width: float = 7.2, height: float = 4.8) -> tuple[Figure, Any]:
    """Make a figure with one three-dimensional panel.

    Parameters
    ----------
    width, height : float
        Inches.

    Returns
    -------
    figure : Figure
    axes : Axes3D
    """
    with matplotlib.rc_context(_RC):
        figure = _Shown(figsize=(width, height), layout="constrained")
        axes = figure.add_subplot(projection="3d")
    return figure, axes


def edges(centres: np.ndarray) -> np.ndarray:
    """Edges of the cells around equally spaced centres.

    Parameters
    ----------
    centres : ndarray, (n,)
        Positions of the centres.

    Returns
    -------
    ndarray, (n + 1,)

    Examples
    --------
    >>> edges(np.array([0.0, 1.0, 2.0])).tolist()
    [-0.5, 0.5, 1.5, 2.5]
    """
    centres = np.asarray(centres, float)
    step = (centres[-1] - centres[0]) / max(len(centres) - 1, 1) or 1.0
    return np.concatenate([centres - step / 2, centres[-1:] + step / 2])


def limit(values: Any, percent: float = 99.5) -> float:
    """Half-width of a balanced colour scale.

    Parameters
    ----------
    values : array_like
        What will be drawn; NaN are left out.
    percent : float, default 99.5
        Share of absolute values inside the scale, percent.

    Returns
    -------
    float
        Positive, also for fields of zeros or without any value.
    """
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

    Parameters
    ----------
    axes : Axes
        Where to draw.
    field : DataArray, (y, x)
        The field; x and y in metres; NaN stay grey.
    label : str
        Of the colour bar, with the unit.
    factor : float, default 1
        From the field's unit to the label's.
    cmap : str
        Colour map.
    scale : tuple of float, optional
        Ends of the colour scale, in the label's unit; by default balanced about zero.
    title : str, optional
        Above the panel.

    Returns
    -------
    QuadMesh
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
    """Put a colour bar beside a panel, as high as the panel.

    Parameters
    ----------
    axes : Axes
        The panel.
    drawn : ScalarMappable
        What has colours.
    label : str
        With the unit.
    extend : str, default "both"
        Which ends have values beyond them.
    """
    bar = axes.inset_axes((1.025, 0.0, 0.035, 1.0))
    axes.figure.colorbar(drawn, cax=bar, label=label, extend=extend)


def moment_title(snapshot: xr.Dataset) -> str:
    """Time of a snapshot, for a title.

    Parameters
    ----------
    snapshot : Dataset
        One step of a cube.

    Returns
    -------
    str
        Such as "t = 1.25 s"; empty without a time.
    """
    return f"t = {round(float(snapshot.time), 3):g} s" if "time" in snapshot.coords else ""


def plain_axes(axes: Axes, **legend: Any) -> None:
    """Give a line plot a light grid, and its legend if it has named lines.

    Parameters
    ----------
    axes : Axes
        The panel.
    **legend
        Of `Axes.legend`, such as loc.
    """
    axes.grid(True, which="major", color="0.88", linewidth=0.7)
    axes.set_axisbelow(True)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(**{"frameon": False, "fontsize": 9} | legend)


def densities(values: Sequence[float] | np.ndarray, bins: np.ndarray) -> np.ndarray:
    """Probability density of values in bins.

    Parameters
    ----------
    values : array_like
        Samples; NaN are left out.
    bins : ndarray, (n + 1,)
        Edges of the bins.

    Returns
    -------
    ndarray, (n,)
        Density, per unit of the values; zeros without a sample.
    """
    finite = np.asarray(values, float).ravel()
    finite = finite[np.isfinite(finite)]
    counts, _ = np.histogram(finite, bins)
    out: np.ndarray = counts / (max(finite.size, 1) * np.diff(bins))
    return out
