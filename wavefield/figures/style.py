"""Sizes, colours, maps and axes that all figures share.

Figures suit colour-blind readers: signed fields are red and blue, positive ones cividis, lines have dashes.
"""

import io
from collections.abc import Iterable, Mapping
from typing import Any

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from wavefield.figures.display import POSITIVE, SIGNED, limit

# colours that contrast with white, most of Okabe and Ito (2008); only the first two have the same dash
LINES: tuple[dict[str, Any], ...] = (
    {"color": "#000000", "linestyle": "-"},
    {"color": "#0072B2", "linestyle": "-"},
    {"color": "#D55E00", "linestyle": "--"},
    {"color": "#009E73", "linestyle": "-."},
    {"color": "#CC79A7", "linestyle": (0, (1, 1))},
    {"color": "#7A5195", "linestyle": (0, (5, 1, 1, 1, 1, 1))},
)
HERTZ, CYCLES = "ω / 2π (Hz)", "k / 2π (m⁻¹)"

_RC: Any = {
    "font.size": 10.5,
    "axes.titlesize": 11,
    "xtick.major.pad": 5,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


class NotebookFigure(Figure):
    """A matplotlib figure that a notebook displays without pyplot."""

    def _repr_png_(self) -> bytes:
        return file_of(self, dpi=100)


def file_of(figure: Figure, **settings: Any) -> bytes:
    """Return a figure as the bytes of a PNG file; `settings` are arguments of `Figure.savefig`."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", **settings)
    return buffer.getvalue()


def panels(
    columns: int, rows: int = 1, *, width: float = 5.2, height: float = 4.1, projection: str | None = None
) -> tuple[Figure, NDArray[np.object_]]:
    """Return a figure that does not use pyplot, and its axes (rows, columns).
    `width` and `height` are the size of one panel, inches; `projection` is matplotlib's, such as "3d"."""
    with matplotlib.rc_context(_RC):
        figure = NotebookFigure(figsize=(width * columns, height * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False, subplot_kw={"projection": projection})
    return figure, axes


def map_panels(
    field: xr.DataArray, columns: int, rows: int = 1, *, width: float = 5.2
) -> tuple[Figure, NDArray[np.object_]]:
    """Return a figure and its axes (rows, columns) for maps of a field with coordinates x and y.
    Each panel is `width` inches wide; its height follows from the extent of the field."""
    wide, high = (float(np.ptp(field[d].values)) or 1.0 for d in ("x", "y"))
    height = float(np.clip(0.74 * width * high / wide + 0.85, 1.6, 1.5 * width))
    return panels(columns, rows, width=width, height=height)


def edges(centres: np.ndarray) -> np.ndarray:
    """Return the edges (n + 1,) of the cells around equally spaced centres (n,)."""
    centres = np.asarray(centres, float)
    step = (centres[-1] - centres[0]) / max(len(centres) - 1, 1) or 1.0
    return np.concatenate([centres - step / 2, centres[-1:] + step / 2])


def draw_cells(
    axes: Axes, x: np.ndarray, y: np.ndarray, values: np.ndarray, label: str, norm: Normalize, cmap: str
) -> None:
    """Draw values (ny, nx) as cells around the centres x (nx,), y (ny,), with a colour bar named `label`.
    `norm` and `cmap` are matplotlib's colour scale and the name of the colour map."""
    drawn = axes.pcolormesh(
        edges(x), edges(y), np.ma.masked_invalid(values), norm=norm, cmap=cmap, rasterized=True
    )
    below, above = np.any(values < norm.vmin), np.any(values > norm.vmax)
    extend = ("neither", "max", "min", "both")[2 * below + above]
    bar = axes.inset_axes((1.025, 0.0, 0.035, 1.0))  # as high as the panel
    axes.figure.colorbar(drawn, cax=bar, label=label, extend=extend)


def draw_map(
    axes: Axes,
    field: xr.DataArray,
    label: str,
    factor: float = 1.0,
    *,
    cmap: str = SIGNED,
    scale: tuple[float, float] | None = None,
    title: str = "",
) -> None:
    """Draw a map of a field (y, x) times `factor`, with a colour bar named `label`.
    `scale` is the lower and upper end of the colours; by default they are symmetric about zero."""
    values = factor * np.asarray(field.transpose("y", "x").values, float)
    if scale is None:
        half = limit(values)
        scale = (-half, half)
    axes.set_facecolor("0.85")
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=title)
    draw_cells(axes, field.x.values, field.y.values, values, label, Normalize(*scale), cmap)


def draw_positive_map(axes: Axes, field: xr.DataArray, label: str, factor: float) -> None:
    """Draw a map of a positive field (y, x) times `factor`, in colours from 0 to its 99 % quantile."""
    draw_map(axes, field, label, factor, cmap=POSITIVE, scale=(0, factor * limit(field, 99)))


def moment_title(snapshot: xr.Dataset) -> str:
    """Return the time of one step of a cube as a title, such as "t = 0.125 s"; empty if it is unknown."""
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
    """Draw curves (n,), given by label, over x (n,); they are thin and pale where `valid` (n,) is False.
    `log` names the logarithmic axes, such as "xy"; `styles` holds matplotlib's properties of each line."""
    for style, (label, values) in zip(styles, curves.items(), strict=False):
        drawn = positive(values) if "y" in log else np.asarray(values)
        if valid is not None:
            axes.plot(x, drawn, color=style["color"], linewidth=0.7, alpha=0.5)
            drawn = np.where(valid, drawn, np.nan)
        axes.plot(x, drawn, label=label, **style)
    axes.set(**{f"{name}scale": "log" for name in log})


def finish(axes: Axes, xlabel: str, ylabel: str, *, columns: int | None = None, **properties: object) -> None:
    """Label the axes of a line plot, set their matplotlib `properties`, and add a grid and a legend above.
    The legend has `columns` columns, by default two, or three for five curves or more."""
    axes.set(xlabel=xlabel, ylabel=ylabel, **properties)
    axes.grid(True, which="major", color="0.88", linewidth=0.7)
    axes.set_axisbelow(True)
    if labels := axes.get_legend_handles_labels()[1]:
        columns = columns or (2 if len(labels) < 5 else 3)
        place: Any = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": columns}
        axes.legend(**place, frameon=False, fontsize=9)


def round_down(value: float) -> float:
    """Return the largest number of the form 1, 2 or 5 times a power of ten that is not above `value` > 0."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(m for m in (1, 2, 5) if m * power <= value * (1 + 1e-9)))
