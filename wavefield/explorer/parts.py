"""Parts that the panels share: the state of a page, figures in one style, data sources, long series."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from html import escape
from importlib.resources import files
from typing import Generic, Protocol, TypeVar
from urllib.parse import urlencode

import numpy as np
from bokeh import palettes
from bokeh.document import Document
from bokeh.events import ConnectionLost, DoubleTap, Tap
from bokeh.layouts import column
from bokeh.models import (
    BasicTicker,
    ColorBar,
    ColumnDataSource,
    CustomJS,
    Div,
    HoverTool,
    LinearColorMapper,
    NumeralTickFormatter,
    Select,
    TabPanel,
    Tabs,
    UIElement,
)
from bokeh.plotting import figure
from jinja2 import Environment
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from wavefield.figures.display import KINDS, POSITIVE, SIGNED, display
from wavefield.variables import TABLE

TABS = ("map", "cameras", "waves")
OVERLAYS = ("arrows", "nothing")  # drawn on the map
_CHOICES = {"tab": TABS, "overlay": OVERLAYS}
Value = str | int | tuple[float, ...] | None


@dataclass(frozen=True)
class Place:
    """The state of a page. The link of the page stores it, such as show=z&step=12&node=0.1,-0.2."""

    show: str = "w"  # variable of the map
    step: int = 0  # index of the step, from 0
    tab: str = "map"  # one of TABS
    limits: tuple[float, float] | None = None  # of the colours, in the displayed unit; None: fitted to values
    overlay: str = "arrows"  # one of OVERLAYS
    node: tuple[float, float] | None = None  # x and y of the clicked node, metres

    @property
    def coloured(self) -> str:
        """Variable of the colour scale; "w" while the map shows the quality, which has no scale."""
        return "w" if self.show == "quality" else self.show

    @property
    def colour_map(self) -> str:
        """The matplotlib colour map of the displayed variable."""
        return display(self.coloured).colour_map

    def query(self) -> str:
        """Return the query of a link to this state.
        Fields with their default value are left out, except the variable and the step."""
        pairs = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple):
                pairs[field.name] = ",".join(f"{number:.6g}" for number in value)
            elif field.name in ("show", "step") or value != field.default:
                pairs[field.name] = str(value)
        return urlencode(pairs, safe=",")

    @classmethod
    def read(
        cls, query: Mapping[str, str], names: Sequence[str] = (), steps: int = 0, first: int = 0
    ) -> "Place":
        """Return the state that the query of a link describes; values that are not valid are ignored.
        `query` maps names of fields to text. `names` are the variables of the cube, `steps` is its number of
        steps, and `first` is the step of the state if the query has none."""
        out = cls(step=first, show="w" if "w" in names or not names else names[0])
        choices = _CHOICES | {"show": tuple(names)}
        for name, text in query.items():
            value = _parse(name, text, choices)
            if value is not None:
                out = replace(out, **{name: value})  # type: ignore[arg-type]  # _parse gives each its type
        return replace(out, step=min(max(out.step, 0), steps - 1)) if steps else out


def _parse(name: str, text: str, choices: Mapping[str, Sequence[str]]) -> Value:
    """Return the value of one field of a query; None if the text is not valid.
    `choices` lists the valid values by field; an empty list allows any text."""
    try:
        if name == "step":
            return int(text)
        if name in ("limits", "node"):
            a, b = (float(part) for part in text.split(","))
            valid = abs(a) < 1e6 and abs(b) < 1e6 and (name == "node" or a < b)
            return (a, b) if valid else None
    except ValueError:
        return None
    allowed = choices.get(name, ("",))  # an unknown name has no valid value
    return text if text and (text in allowed or not allowed) else None


INK, GREY, BLUE, VERMILION, GREEN = "#1b1f24", "#d9d9d9", "#0072B2", "#D55E00", "#009E73"
SKY, YELLOW = "#56B4E9", "#F0E442"
MOST_POINTS = 8000  # points of a line: enough for zooming in, few enough to draw without a delay
IMAGE = "image x y dw dh"  # columns of the data source of an image
_PALETTES = {SIGNED: palettes.RdBu11, POSITIVE: palettes.Cividis256}
_KEYS = (
    ("← →", "step"), ("space", "play"), ("1–3", "views"), ("M", "mask"), ("P", "pick"), ("A", "arrows"),
    ("Home End", "first, last step"),
)  # fmt: skip
_LOADING = '<span class="loading" role="status">Loading …</span>'
_SPINNER = """.loading::before { content: ""; display: inline-block; width: 14px; height: 14px;
margin: 0 8px -2px 0; border: 2px solid #d0d7de; border-top-color: #0072B2; border-radius: 50%;
animation: turn 1s linear infinite; }
@keyframes turn { to { transform: rotate(1turn); } }"""
_DEFAULTS: dict[str, object] = {
    "sizing_mode": "stretch_width", "toolbar_location": None, "tools": "xpan,xwheel_zoom,reset",
    "min_border_left": 62, "min_border_right": 12, "min_border_top": 4,
    "output_backend": "canvas", "lod_threshold": None,
}  # fmt: skip
Series = NDArray[np.floating]


class Panel(Protocol):
    """The content of a tab."""

    layout: UIElement  # figures and widgets of the panel

    def show(self, place: Place) -> None:
        """Update the figures of the panel to the state of the page."""
        ...


P = TypeVar("P", bound=Panel)


@dataclass(frozen=True)
class PanelEvents:
    """Functions of the page that its panels call when the user does something."""

    picked: Callable[[float, float], None]  # with x and y, metres, when the user picks a point
    # with a click's camera, column and row, px; returns whether the click became a corner of a mask
    took_corner: Callable[[str, float, float], bool]
    masks_changed: Callable[[], None]  # when corners of a mask were added or removed
    image_chosen: Callable[[], None]  # when the user chose another camera or overlay


class LazyPanel(Generic[P]):
    """A panel that `make` builds when its tab is first opened; until then the tab shows "Loading"."""

    def __init__(self, make: Callable[[], P]) -> None:
        loading = text_line("", _LOADING, html=True)
        loading.stylesheets = [_SPINNER]  # the style sheet of the page does not apply inside Bokeh's widgets
        self.body = column(loading, sizing_mode="stretch_width")
        self._make = make
        self._made: P | None = None

    @property
    def made(self) -> bool:
        """Whether the panel has been made, because its tab was opened."""
        return self._made is not None

    def __call__(self) -> P:
        """Return the panel; at the first call it is made and put into the tab."""
        if self._made is None:
            self._made = self._make()
            self.body.children = [self._made.layout]
        return self._made


def make_figure(name: str, **settings: object) -> figure:
    """Return a Bokeh figure in the style of the pages: full width, light grid, no toolbar.
    `settings` are those of `bokeh.plotting.figure`, and replace the style."""
    settings = _DEFAULTS | settings
    if isinstance(settings["tools"], str):
        wheels = [tool for tool in settings["tools"].split(",") if tool.endswith("wheel_zoom")]
        settings["active_scroll"] = wheels[0] if wheels else None
    made = figure(name=name, **settings)
    made.grid.grid_line_color = "#e4e7ea"
    made.outline_line_color = "#8b949e"
    made.axis.axis_label_text_font_style = made.title.text_font_style = "normal"
    made.axis.axis_label_text_font_size = "12px"
    made.axis.major_label_text_font_size = "11px"
    made.axis.axis_label_standoff = 4
    made.title.text_font_size = "13px"
    made.title.text_color = INK
    made.toolbar.logo = None
    if "height" in settings and settings.get("y_axis_type") != "log":
        made.yaxis.ticker = BasicTicker(desired_num_ticks=max(3, made.height // 40), num_minor_ticks=0)
    return made


def make_tabs(name: str, active: int, titles: Sequence[str], bodies: Sequence[UIElement]) -> Tabs:
    """Return tabs with titles and bodies; `active` is the index of the open one.
    A body never widens the page, and a hidden one is not laid out."""
    tabs = [TabPanel(child=body, title=title) for title, body in zip(titles, bodies)]
    narrow = {"grid-template-columns": "minmax(0, 1fr)", "min-width": "0"}
    made = Tabs(tabs=tabs, active=active, name=name, sizing_mode="stretch_width", styles=narrow)
    for k, body in enumerate(bodies):
        body.visible = k == active
    code = "bodies.forEach((body, k) => { body.visible = k == cb_obj.active })"
    made.js_on_change("active", CustomJS(args={"bodies": list(bodies)}, code=code))
    return made


def make_sources(prefix: str, **columns: str) -> dict[str, ColumnDataSource]:
    """Return one empty Bokeh data source for each keyword argument, by keyword.

    The value of an argument lists the columns of the source, separated by spaces. The name of the source is
    the prefix, an underscore and the keyword.

    Examples
    --------
    >>> make_sources("map", node="x y")["node"].name
    'map_node'
    """
    return {
        key: ColumnDataSource({name: [] for name in names.split()}, name=f"{prefix}_{key}")
        for key, names in columns.items()
    }


def clear(*sources: ColumnDataSource) -> None:
    """Empty the columns of data sources."""
    for source in sources:
        source.data = {name: [] for name in source.data}


def on_click(made: figure, handle: Callable[[Tap], None]) -> None:
    """Call `handle` at every click on a figure.
    Bokeh reports a second click within 0.3 s as another event, which is handled as well."""
    for event in (Tap, DoubleTap):
        made.on_event(event, handle)


def add_hover(
    made: figure, *rows: tuple[str, str], renderers: Sequence[object] = (), mode: str = "mouse"
) -> None:
    """Add a tooltip for the point under the pointer to a figure; each row is a name and a format of Bokeh.
    `renderers` are the drawings with a tooltip, by default all. `mode` is an argument of Bokeh's
    HoverTool."""
    drawn = list(renderers) or "auto"
    made.add_tools(HoverTool(tooltips=list(rows), mode=mode, renderers=drawn, line_policy="nearest"))


@cache
def asset(name: str) -> str:
    """Return the text of the file `name` in the folder `assets` of the pages."""
    return files("wavefield.explorer").joinpath(f"assets/{name}").read_text(encoding="utf-8")


def apply_template(
    document: Document,
    heading: str,
    command: str,
    places: Sequence[str],
    keys: bool = True,
    aspect: float = 1.3,
) -> None:
    """Set the HTML template of a Bokeh document.
    `heading` and `command`, the name of the wavefield command, make the title. `places` are the names of the
    root elements, in order. With `keys` the page lists the keyboard keys. `aspect`, the width over the height
    of the map, limits the width of the tabs so that the map fits into the height of the window."""
    document.title = f"{heading} – wavefield {command}"
    document.template = Environment(autoescape=True).from_string(asset("page.html"))
    document.template_variables.update(
        heading=heading, command=command, places=list(places), css=asset("page.css"), script=asset("page.js"),
        keys=_KEYS if keys else (), aspect=f"{aspect:.4f}",
    )  # fmt: skip
    document.js_on_event(ConnectionLost, CustomJS(code='document.getElementById("lost").hidden = false'))


# -- words ---------------------------------------------------------------------------------------------


def text_line(name: str, text: str = "", html: bool = False) -> Div:
    """Return a paragraph of full width; with `html`, `text` is HTML that the caller has escaped."""
    return Div(
        text=text, name=name, sizing_mode="stretch_width", render_as_text=not html, disable_math=True
    )  # fmt: skip


def number(value: float, digits: int = 3) -> str:
    """Return a number as text to some significant digits, with a typographic minus sign."""
    return f"{value:.{digits}g}".replace("-", "\u2212")


def plain(words: object) -> str:
    """Return `words` as text for HTML: the characters that HTML reserves are escaped."""
    return escape(str(words), quote=False)


def alert(error: Exception) -> str:
    """Return the message of an error as HTML that screen readers announce."""
    return f'<span role="alert">{plain(error)}</span>'


def chosen(choice: Select) -> str:
    """Return the value that the user chose in a list, or its first option if the browser sent no option."""
    values = [option if isinstance(option, str) else str(option[0]) for option in choice.options]
    return str(choice.value) if choice.value in values else next(iter(values), "")


def named(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return a pair for each variable: its name, and the name with its meaning, as options of a list."""
    return [(name, f"{name}: {TABLE[name].long_name}") for name in names]


# -- drawing -------------------------------------------------------------------------------------------


def draw_band(made: figure, source: ColumnDataSource, x: str, y: str, **line: object) -> None:
    """Draw a line through the columns x and y of a source, and the band between its columns `low` and `high`.
    `line` are settings of the line, as in Bokeh."""
    made.varea(x, "low", "high", source=source, fill_color=BLUE, fill_alpha=0.22)
    made.line(x, y, source=source, **({"line_color": BLUE, "line_width": 1.6} | line))


def draw_ring(made: figure, source: ColumnDataSource, x: str, y: str, colour: str, size: int) -> None:
    """Draw a ring, `size` px wide, with a white outline around each point in columns x, y of a source."""
    for ring, width in (("white", 5.0), (colour, 2.3)):
        made.scatter(x, y, source=source, size=size, fill_color=None, line_color=ring, line_width=width)


def probe_columns(names: Sequence[str], x: Series, y: Series, middle: float) -> dict[str, list[object]]:
    """Return the columns of a source for `draw_probes`, for probes at x, y (n,), metres.
    A name stands on the right of its probe. If x is above `middle`, metres, it stands on the left, so that it
    does not leave the map."""
    right = [float(at) > middle for at in x]
    return {
        "x": list(x),
        "y": list(y),
        "name": list(names),
        "align": ["right" if one else "left" for one in right],
        "offset": [-9 if one else 9 for one in right],
    }


def draw_probes(made: figure, source: ColumnDataSource) -> None:
    """Draw a triangle and the name of each probe in a source that `probe_columns` filled."""
    made.scatter("x", "y", source=source, marker="triangle", size=11, fill_color=YELLOW, line_color=INK)
    made.text(
        "x", "y", "name", source=source, x_offset="offset", y_offset=4, text_align="align",
        text_font_size="11px", padding=2, background_fill_color="white", background_fill_alpha=0.75,
    )  # fmt: skip


def draw_masks(made: figure, drawn: ColumnDataSource, saved: ColumnDataSource) -> None:
    """Draw the masks of the source `saved`, and the corners of the new mask in the source `drawn`."""
    made.patches(
        "xs", "ys", source=saved, fill_alpha=0.15, fill_color=INK, hatch_pattern="/", hatch_alpha=0.5,
        hatch_color="white", line_color=INK, line_width=1.5,
    )  # fmt: skip
    made.patch("x", "y", source=drawn, fill_alpha=0.25, fill_color=VERMILION, line_color=None)
    made.line("x", "y", source=drawn, color="white", line_width=4.5)
    made.line("x", "y", source=drawn, color=VERMILION, line_width=2)
    made.scatter("x", "y", source=drawn, size=8, fill_color="white", line_color=VERMILION, line_width=2)


@cache
def palette(colour_map: str) -> list[str]:
    """Return 256 colours of the matplotlib colour map "RdBu_r" or "cividis"."""
    return list(palettes.interp_palette(_PALETTES[colour_map], 256))


def quality_mapper() -> LinearColorMapper:
    """Return the Bokeh colour mapper for the kind of quality of a node, which is an index into `KINDS`."""
    return LinearColorMapper(palette=[colour for _, _, colour in KINDS], low=-0.5, high=len(KINDS) - 0.5)


def grey_mapper() -> LinearColorMapper:
    """Return a Bokeh colour mapper for grey levels from 0 to 255."""
    return LinearColorMapper(palette=[f"#{k:02x}{k:02x}{k:02x}" for k in range(256)], low=0, high=255)


def colour_bar(mapper: LinearColorMapper) -> ColorBar:
    """Return a colour bar of a mapper, for the right side of a figure."""
    return ColorBar(
        color_mapper=mapper, width=14, padding=8, margin=0, major_label_text_font_size="11px",
        ticker=BasicTicker(desired_num_ticks=7), formatter=NumeralTickFormatter(format="0.[000]"),
    )  # fmt: skip


def image_data(values: Series, x: Series, y: Series) -> dict[str, list[object]]:
    """Return the columns of a data source that draws values (ny, nx) as one image.
    Each pixel is centred on its node, at x (nx,) and y (ny,), metres."""
    dx, dy = (float(v[-1] - v[0]) / max(len(v) - 1, 1) or 1.0 for v in (x, y))
    return {
        "image": [np.ascontiguousarray(values, np.float32)],
        "x": [float(x[0]) - dx / 2],
        "y": [float(y[0]) - dy / 2],
        "dw": [dx * len(x)],
        "dh": [dy * len(y)],
    }


# -- long series ---------------------------------------------------------------------------------------


def envelope(x: Series, *series: Series) -> tuple[Series, ...]:
    """Return x and the series (n,), thinned to the same m samples so that crests and troughs stay visible.
    In each bin of successive samples, the two are kept at which the first series is lowest and highest.
    Series of at most `MOST_POINTS` samples are returned unchanged."""
    if x.size <= MOST_POINTS:
        return (x, *series)
    width = -(-2 * x.size // MOST_POINTS)
    binned = x.size - x.size % width
    bins = series[0][:binned].reshape(-1, width)
    finite = np.isfinite(bins)
    start = np.arange(bins.shape[0]) * width
    lowest = start + np.where(finite, bins, np.inf).argmin(axis=1)
    highest = start + np.where(finite, bins, -np.inf).argmax(axis=1)  # an empty bin keeps its first sample
    keep = np.unique(np.concatenate([lowest, highest, np.arange(binned, x.size)]))
    return tuple(part[keep] for part in (x, *series))


def band(value: Series, std: Series, thinned: bool) -> tuple[Series, Series]:
    """Return the edges value - std and value + std, each (n,), of a band; NaN in gaps.
    `thinned` tells that `envelope` has thinned the series, which then alternates between crests and troughs.
    The band is widened in that case to enclose the two neighbours of each point, because an alternating band
    would hide the line."""
    low, high = value - std, value + std
    if not thinned:
        return low, high
    gap = np.isnan(low)
    low = np.fmin.reduce(sliding_window_view(np.pad(low, 1, "edge"), 3), axis=1)
    high = np.fmax.reduce(sliding_window_view(np.pad(high, 1, "edge"), 3), axis=1)
    return np.where(gap, np.nan, low), np.where(gap, np.nan, high)
