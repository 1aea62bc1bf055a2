"""Sizes, colours, maps and axes that all figures share.

Signed fields are drawn in red and blue, balanced about zero, positive ones in cividis; colour-blind readers
can read both. Lines differ by dash as well as by colour.
"""

import io
from collections.abc import Iterable, Mapping
from typing import Any

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import ArrayLike, NDArray

from wavefield.figures.display import POSITIVE, SIGNED, limit

# those colours of Okabe and Ito (2008) that contrast with white, each with its own dash
LINES: tuple[dict[str, Any], ...] = (
    {"color": "#000000", "linestyle": "-"},
    {"color": "#0072B2", "linestyle": "-"},
    {"color": "#D55E00", "linestyle": "--"},
    {"color": "#009E73", "linestyle": "-."},
    {"color": "#CC79A7", "linestyle": (0, (1, 1))},
    {"color": "#7A5195", "linestyle": (0, (5, 1, 1, 1, 1, 1))},
)
HERTZ, CYCLES = "ω / 2π (Hz)", "k / 2π (m⁻¹)"
ABOVE: dict[str, object] = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": 2}
RIGHT: dict[str, object] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "ncols": 1}

_RC: Any = {
    "font.size": 10.5,
    "axes.titlesize": 11,
    "axes.labelsize": 10.5,
    "axes.grid": False,
    "xtick.major.pad": 5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": "white",
}


class NotebookFigure(Figure):
    """A matplotlib figure that a notebook displays without pyplot."""

    def _repr_png_(self) -> bytes:
        return file_of(self, dpi=100)


def file_of(figure: Figure, kind: str = "png", **settings: Any) -> bytes:
    """Return the content of a PNG or SVG file of a figure; settings are those of `Figure.savefig`."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, **settings)
    return buffer.getvalue()


def panels(
    columns: int, rows: int = 1, *, width: float = 5.2, height: float = 4.1, projection: str | None = None
) -> tuple[Figure, NDArray[np.object_]]:
    """Return a figure with rows and columns of axes, and the axes (rows, columns); pyplot is not used.
    `width` and `height` are the size of one panel in inches. `projection` is a projection of matplotlib, such
    as "3d"."""
    with matplotlib.rc_context(_RC):
        figure = NotebookFigure(figsize=(width * columns, height * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False, subplot_kw={"projection": projection})
    return figure, axes


def map_panels(
    field: xr.DataArray, columns: int, rows: int = 1, *, width: float = 5.2
) -> tuple[Figure, NDArray[np.object_]]:
    """Return a figure and its axes (rows, columns) with the proportions for maps of a field (y, x).
    `width` is the width of one panel in inches."""
    wide, high = (float(np.ptp(field[d].values)) or 1.0 for d in ("x", "y"))
    height = float(np.clip(0.74 * width * high / wide + 0.85, 1.6, 1.5 * width))
    return panels(columns, rows, width=width, height=height)


def edges(centres: np.ndarray) -> np.ndarray:
    """Return the edges (n + 1,) of the cells around equally spaced centres (n,)."""
    centres = np.asarray(centres, float)
    step = (centres[-1] - centres[0]) / max(len(centres) - 1, 1) or 1.0
    return np.concatenate([centres - step / 2, centres[-1:] + step / 2])


def draw_cells(
    axes: Axes,
    x: np.ndarray,
    y: np.ndarray,
    values: np.ndarray,
    label: str,
    *,
    norm: Normalize,
    cmap: str,
    extend: str = "both",
) -> None:
    """Draw values (ny, nx) as cells around their centres x (nx,), y (ny,), with a colour bar.
    `label` and `extend` are those of the colour bar, as in matplotlib."""
    drawn = axes.pcolormesh(
        edges(x), edges(y), np.ma.masked_invalid(values), norm=norm, cmap=cmap, rasterized=True
    )
    colour_bar(axes, drawn, label, extend)


def colour_bar(axes: Axes, drawn: ScalarMappable, label: str, extend: str = "both") -> None:
    """Put a colour bar of the drawing `drawn` on the right of a panel, as high as the panel."""
    bar = axes.inset_axes((1.025, 0.0, 0.035, 1.0))
    axes.figure.colorbar(drawn, cax=bar, label=label, extend=extend)


def draw_map(
    axes: Axes,
    field: xr.DataArray,
    label: str,
    *,
    factor: float = 1.0,
    cmap: str = SIGNED,
    scale: tuple[float, float] | None = None,
    title: str = "",
    norm: Normalize | None = None,
) -> None:
    """Draw a map of a field (y, x) times a factor, with a colour bar.
    `scale` holds the values at the lower and upper end of the colours; by default they are balanced about
    zero. If `norm`, a matplotlib norm, is given, it sets the colours in place of `scale`."""
    values = factor * np.asarray(field.transpose("y", "x").values, float)
    if scale is None:
        half = limit(values)
        scale = (-half, half)
    axes.set_facecolor("0.85")
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=title)
    extend = "neither" if scale == (0, 100) else "max" if scale[0] == 0 else "both"
    norm = norm or Normalize(*scale)
    draw_cells(axes, field.x.values, field.y.values, values, label, norm=norm, cmap=cmap, extend=extend)


def draw_positive_map(
    axes: Axes, field: xr.DataArray, label: str, factor: float = 1.0, percent: float = 99
) -> None:
    """Draw a map of a positive field (y, x) times a factor, with a colour bar.
    The colours go from 0 to the percentile `percent` of the field."""
    top = factor * limit(field, percent)
    draw_map(axes, field, label, factor=factor, cmap=POSITIVE, scale=(0, top))


def rms_in_time(field: xr.DataArray) -> xr.DataArray:
    """Return the root mean square over time, (y, x), of a field (time, y, x)."""
    return ((field.astype(float) ** 2).mean("time") ** 0.5).compute()


def moment_title(snapshot: xr.Dataset) -> str:
    """Return the time of a snapshot as a title, such as "t = 0.125 s"; empty if it is unknown."""
    return f"t = {round(float(snapshot.time), 3):g} s" if "time" in snapshot.coords else ""


def hertz(group: xr.Dataset | xr.DataArray) -> np.ndarray:
    """Return the frequencies (n,), Hz, at which a group of a wave store has values."""
    return np.asarray(group.omega.values / (2 * np.pi))


def cycles(group: xr.Dataset | xr.DataArray) -> np.ndarray:
    """Return the wavenumbers (n,), cycles per metre, at which a group of a wave store has values."""
    return np.asarray(group.k.values / (2 * np.pi))


def positive(values: ArrayLike) -> np.ndarray:
    """Return values for a logarithmic axis, with NaN in place of those that are not positive."""
    array = np.asarray(values)
    return np.where(array > 0, array, np.nan)


def draw_curves(
    axes: Axes,
    x: np.ndarray,
    curves: Mapping[str, ArrayLike],
    styles: Iterable[Mapping[str, Any]] = LINES,
    *,
    log: str = "",
    valid: np.ndarray | None = None,
) -> None:
    """Draw labelled curves (n,) over x (n,), each in the next style of `styles`.
    `log` names the logarithmic axes, such as "xy". Curves are thin and pale where `valid` (n,) is False."""
    for style, (label, values) in zip(styles, curves.items(), strict=False):
        drawn = positive(values) if "y" in log else np.asarray(values)
        if valid is not None:
            axes.plot(x, drawn, color=style["color"], linewidth=0.7, alpha=0.5)
            drawn = np.where(valid, drawn, np.nan)
        axes.plot(x, drawn, label=label, **style)
    axes.set(**{f"{name}scale": "log" for name in log})


def plain_axes(axes: Axes, **legend: object) -> None:
    """Add a light grid to a line plot, and a legend outside the axes if its lines have labels.
    `legend` holds arguments of matplotlib's `Axes.legend`."""
    axes.grid(True, which="major", color="0.88", linewidth=0.7)
    axes.set_axisbelow(True)
    if labels := axes.get_legend_handles_labels()[1]:
        place = RIGHT if axes.get_title() else ABOVE | {"ncols": 2 if len(labels) < 5 else 3}
        options: dict[str, Any] = {"frameon": False, "fontsize": 9} | place | legend
        axes.legend(**options)


def finish(
    axes: Axes, xlabel: str, ylabel: str, legend: Mapping[str, object] | None = None, **properties: object
) -> None:
    """Set the axis labels of a line plot, and add a grid and a legend.
    `legend` holds arguments of matplotlib's `Axes.legend`, `properties` further arguments of `Axes.set`."""
    axes.set(xlabel=xlabel, ylabel=ylabel, **properties)
    plain_axes(axes, **(legend or {}))


def frequency_axis(axes: Axes) -> None:
    """Label a logarithmic x axis of one or two decades with 1, 2 and 5 times powers of ten."""
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())


def round_down(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(m for m in (1, 2, 5) if m * power <= value * (1 + 1e-9)))


def densities(values: ArrayLike, bins: np.ndarray) -> np.ndarray:
    """Return the probability density (n,) of the finite `values` in bins with the edges `bins` (n + 1,).
    Values outside the bins count in the norm."""
    finite = np.asarray(values, float).ravel()
    finite = finite[np.isfinite(finite)]
    counts, _ = np.histogram(finite, bins)
    return np.asarray(counts / (max(finite.size, 1) * np.diff(bins)))
