"""What all panels share: figures of one look, colour bars, thinning of long series for a screen."""

from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from bokeh.layouts import column
from bokeh.models import (
    BasicTicker,
    ColorBar,
    ColumnDataSource,
    CustomJS,
    FixedTicker,
    LinearColorMapper,
    NumeralTickFormatter,
    Spacer,
    TabPanel,
    Tabs,
)
from bokeh.plotting import figure
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

INK, GREY, BLUE, VERMILION, GREEN, PINK = "#1b1f24", "#d9d9d9", "#0072B2", "#D55E00", "#009E73", "#CC79A7"
MOST_POINTS = 1000  # of one line on a screen: two a pixel of half a page


def make_figure(name: str, **settings: Any) -> Any:
    """A figure as all are: wide as its place, light grid, tools out of the way."""
    usual: dict[str, Any] = {
        "sizing_mode": "stretch_width",
        "toolbar_location": None,
        "tools": "xpan,xwheel_zoom,reset",
        "min_border_left": 62,
        "min_border_right": 12,
        "min_border_top": 4,
        "output_backend": "canvas",
        "lod_threshold": None,
    }
    settings = usual | settings
    tools = settings["tools"]
    if isinstance(tools, str):
        wheels = [tool for tool in tools.split(",") if tool.endswith("wheel_zoom")]
        settings["active_scroll"] = wheels[0] if wheels else None
    made = figure(name=name, **settings)
    made.grid.grid_line_color = "#e4e7ea"
    made.outline_line_color = "#8b949e"
    made.axis.axis_label_text_font_style = "normal"
    made.axis.axis_label_text_font_size = "12px"
    made.axis.major_label_text_font_size = "11px"
    made.axis.axis_label_standoff = 4
    made.title.text_font_size = "13px"
    made.title.text_font_style = "normal"
    made.title.text_color = INK
    return made


class Panel(Protocol):
    """What fills a tab."""

    @property
    def layout(self) -> Any:
        """Its figures and widgets."""


P = TypeVar("P", bound=Panel)


class Later(Generic[P]):
    """A panel that is made when its tab is first opened: a page is seen before what nobody has asked for."""

    def __init__(self, make: Callable[[], P]) -> None:
        self.body = column(Spacer(height=1), sizing_mode="stretch_width")  # of nothing at all Bokeh warns
        self._make = make
        self._made: P | None = None

    def __call__(self) -> P:
        """The panel, in its place."""
        if self._made is None:
            self._made = self._make()
            self.body.children = [self._made.layout]
        return self._made


def make_tabs(name: str, active: int, panels: Sequence[tuple[str, Any]]) -> Tabs:
    """Tabs that are never wider than their place.

    With panels (str, layout).
    """
    tabs = [TabPanel(child=body, title=title) for title, body in panels]
    narrow = {"grid-template-columns": "minmax(0, 1fr)", "min-width": "0"}
    made = Tabs(tabs=tabs, active=active, name=name, sizing_mode="stretch_width", styles=narrow)
    bodies = [body for _, body in panels]
    for k, body in enumerate(bodies):  # what is hidden takes neither room nor time
        body.visible = k == active
    code = "bodies.forEach((body, k) => { body.visible = k == cb_obj.active })"
    made.js_on_change("active", CustomJS(args={"bodies": bodies}, code=code))
    return made


def draw_masks(made: Any, drawn: ColumnDataSource, there: ColumnDataSource) -> None:
    """Draw what is masked, and the corners of what is being drawn."""
    made.patches(
        "xs", "ys", source=there, fill_alpha=0.15, fill_color=INK, hatch_pattern="/", hatch_alpha=0.5,
        hatch_color="white", line_color=INK, line_width=1.5,
    )  # fmt: skip
    made.patch("x", "y", source=drawn, fill_alpha=0.25, fill_color=VERMILION, line_color=None)
    made.line("x", "y", source=drawn, color="white", line_width=4.5)
    made.line("x", "y", source=drawn, color=VERMILION, line_width=2)
    made.scatter("x", "y", source=drawn, size=8, fill_color="white", line_color=VERMILION, line_width=2)


def colour_bar(mapper: LinearColorMapper, title: str = "") -> ColorBar:
    """A colour bar beside a map."""
    return ColorBar(
        color_mapper=mapper,
        title=title,
        width=14,
        padding=8,
        margin=0,
        title_text_font_style="normal",
        title_text_font_size="12px",
        major_label_text_font_size="11px",
        ticker=BasicTicker(desired_num_ticks=7),
        formatter=NumeralTickFormatter(format="0.[000]"),
    )


def fixed_labels(bar: ColorBar, labels: list[str]) -> None:
    """Name the colours of a bar of kinds."""
    bar.ticker = FixedTicker(ticks=list(range(len(labels))))
    bar.major_label_overrides = dict(enumerate(labels))


def image_data(values: NDArray[Any], x: NDArray[Any], y: NDArray[Any]) -> dict[str, list[Any]]:
    """Columns of an image whose pixels are centred on nodes.

    With values (ny, nx); x, y (nx,).
    """
    dx, dy = (float(v[-1] - v[0]) / max(len(v) - 1, 1) or 1.0 for v in (x, y))
    return {
        "image": [np.ascontiguousarray(values, np.float32)],
        "x": [float(x[0]) - dx / 2],
        "y": [float(y[0]) - dy / 2],
        "dw": [dx * len(x)],
        "dh": [dy * len(y)],
    }


def image_source(name: str) -> ColumnDataSource:
    """An empty source of an image."""
    return ColumnDataSource({"image": [], "x": [], "y": [], "dw": [], "dh": []}, name=name)


def envelope(x: NDArray[Any], *series: NDArray[Any], most: int = MOST_POINTS) -> tuple[NDArray[Any], ...]:
    """Thin long series for a screen: of each bin the lowest and the highest value, in their order.

    With x (n,); *series (n,); returns (m,): x and the series at the kept samples.

    Examples
    --------
    >>> x = np.arange(10000.0)
    >>> y = np.zeros(10000)
    >>> y[4321] = 1.0
    >>> thin_x, thin_y = envelope(x, y)
    >>> len(thin_x) <= 1000, float(thin_x[thin_y.argmax()])
    (True, 4321.0)
    """
    if x.size <= most:
        return (x, *series)
    lead = series[0]
    width = -(-2 * x.size // most)
    whole = x.size - x.size % width
    bins = np.where(np.isfinite(lead[:whole]), lead[:whole], np.nan).reshape(-1, width)
    empty = ~np.isfinite(bins).any(axis=1)
    lowest = np.where(np.isfinite(bins), bins, np.inf).argmin(axis=1)
    highest = np.where(np.isfinite(bins), bins, -np.inf).argmax(axis=1)
    start = np.arange(bins.shape[0]) * width
    keep = np.unique(
        np.concatenate([start + lowest, start + highest, start[empty], np.arange(whole, x.size)])
    )
    return tuple(part[keep] for part in (x, *series))


def band(
    value: NDArray[Any], std: NDArray[Any], thinned: bool
) -> tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]]:
    """Edges of the band of uncertainty around a series.

    Of a thinned series, which leaps between crests and troughs, they enclose neighbours too: a band that
    leaps with it hides the line, and takes a browser seven times as long to fill.

    With value, std (n,); returns low, high (n,): NaN in gaps.

    Examples
    --------
    >>> low, high = band(np.array([0.0, 4.0, 1.0, 5.0]), np.full(4, 0.5), thinned=True)
    >>> low.tolist(), high.tolist()
    ([-0.5, -0.5, 0.5, 0.5], [4.5, 4.5, 5.5, 5.5])
    """
    low, high = value - std, value + std
    if not thinned:
        return low, high
    gap = np.isnan(low)
    low = np.fmin.reduce(sliding_window_view(np.pad(low, 1, "edge"), 3), axis=1)
    high = np.fmax.reduce(sliding_window_view(np.pad(high, 1, "edge"), 3), axis=1)
    return np.where(gap, np.nan, low), np.where(gap, np.nan, high)


def number(value: float, digits: int = 3) -> str:
    """A number for people, with a real minus sign."""
    return f"{value:.{digits}g}".replace("-", "\u2212")
