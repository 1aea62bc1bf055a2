"""What the panels share: the state of a page, figures in one style, data sources, thinning of long series."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cache
from html import escape
from importlib import import_module
from importlib.resources import files
from typing import Any
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
from jinja2 import Environment, Template
from numpy.typing import NDArray

from wavefield.figures.display import KINDS, POSITIVE, SIGNED
from wavefield.variables import TABLE

TABS = ("map", "cameras", "waves")
OVERLAYS = ("arrows", "nothing")  # drawn on the map


@dataclass(frozen=True)
class Place:
    """The state of a page: variable, step, tab, ... Links contain it, as in show=z&step=12&node=0.1,-0.2."""

    show: str = "w"  # variable of the map
    step: int = 0  # index of the step, from 0
    tab: str = "map"  # one of TABS
    limits: tuple[float, float] | None = None  # of the colours, in the displayed unit; None: fitted to values
    overlay: str = "arrows"  # one of OVERLAYS
    node: tuple[float, float] | None = None  # x and y of the clicked node, metres

    def query(self) -> str:
        """Return this state as the query of a link. Default values are left out, except `show` and `step`."""
        pairs = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple):
                pairs[field.name] = ",".join(f"{number:.6g}" for number in value)
            elif field.name in ("show", "step") or value != field.default:
                pairs[field.name] = str(value)
        return urlencode(pairs, safe=",")

    @classmethod
    def read(cls, query: Mapping[str, str], names: Sequence[str], steps: int, first: int = 0) -> "Place":
        """Return the state that the query of a link describes, with defaults in place of invalid values.
        `names` are the variables of the cube, `steps` its number of steps, and `first` the default step."""
        choices = {"show": names, "tab": TABS, "overlay": OVERLAYS}
        found: dict[str, Any] = {name: text for name, text in query.items() if text in choices.get(name, ())}
        for name in query.keys() & {"limits", "node"}:
            with suppress(ValueError):
                a, b = (float(part) for part in query[name].split(","))
                if abs(a) < 1e6 and abs(b) < 1e6 and (name == "node" or a < b):
                    found[name] = a, b
        step = int(query["step"]) if query.get("step", "").isdecimal() else first
        return cls(**{"show": "w" if "w" in names else names[0]} | found | {"step": min(step, steps - 1)})


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
_DEFAULTS: dict[str, object] = {
    "sizing_mode": "stretch_width", "toolbar_location": None, "tools": "xpan,xwheel_zoom,reset",
    "min_border_left": 62, "min_border_right": 12, "min_border_top": 4,
    "output_backend": "canvas", "lod_threshold": None,
}  # fmt: skip
Series = NDArray[np.floating]


class LazyPanel:
    """A panel that is imported and made when its tab is first opened; until then the tab shows "Loading".
    `module` and `kind` are the names of its module and its class. The class is called with `arguments`."""

    def __init__(self, module: str, kind: str, *arguments: object) -> None:
        loading = text_line("", _LOADING, html=True)
        loading.stylesheets = [
            asset("spinner.css")
        ]  # the style sheet of the page does not apply inside Bokeh's widgets
        self.body = column(loading, sizing_mode="stretch_width")
        self._module, self._kind, self._arguments = module, kind, arguments
        self.made: Any = None  # the panel, when its tab has been opened

    def __call__(self) -> Any:
        """Return the panel; at the first call it is made and put into the tab."""
        if self.made is None:
            module = import_module(f"wavefield.explorer.{self._module}")
            self.made = getattr(module, self._kind)(*self._arguments)
            self.body.children = [self.made.layout]
        return self.made


def make_figure(name: str, **settings: object) -> figure:
    """Return a Bokeh figure in the style of the pages; `settings`, arguments of Bokeh, override the style."""
    settings = _DEFAULTS | settings
    if isinstance(settings["tools"], str):
        settings["active_scroll"] = "xwheel_zoom" if "xwheel_zoom" in settings["tools"] else "wheel_zoom"
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
    """Return Bokeh tabs with these titles and contents (`bodies`); the tab with the index `active` is open.
    Tabs never widen the page, and the contents of closed tabs are not laid out."""
    tabs = [TabPanel(child=body, title=title) for title, body in zip(titles, bodies)]
    narrow = {"grid-template-columns": "minmax(0, 1fr)", "min-width": "0"}
    made = Tabs(tabs=tabs, active=active, name=name, sizing_mode="stretch_width", styles=narrow)
    for k, body in enumerate(bodies):
        body.visible = k == active
    code = "bodies.forEach((body, k) => { body.visible = k == cb_obj.active })"
    made.js_on_change("active", CustomJS(args={"bodies": list(bodies)}, code=code))
    return made


def make_sources(prefix: str, **columns: str) -> dict[str, ColumnDataSource]:
    """Return empty Bokeh data sources by keyword: node="x y" makes a source with the columns x and y.
    With the prefix "map" its name is "map_node"."""
    return {
        key: ColumnDataSource({name: [] for name in names.split()}, name=f"{prefix}_{key}")
        for key, names in columns.items()
    }


def clear(*sources: ColumnDataSource) -> None:
    """Empty the columns of data sources."""
    for source in sources:
        source.data = {name: [] for name in source.data}


def on_click(made: figure, handle: Callable[[Tap], None]) -> None:
    """Call `handle` with Bokeh's event at every click on a figure, single or double."""
    for event in (Tap, DoubleTap):  # a second click within 0.3 s is another event
        made.on_event(event, handle)


def add_hover(made: figure, *rows: tuple[str, str], renderers: Sequence[object], mode: str = "mouse") -> None:
    """Add a tooltip to the drawings `renderers` of a figure; a row is a label and a format such as "@x".
    `mode` is that of Bokeh's HoverTool: "vline" shows the tooltip of all points above or below the mouse."""
    tooltips, drawn = list(rows), list(renderers)
    made.add_tools(HoverTool(tooltips=tooltips, mode=mode, renderers=drawn, line_policy="nearest"))


@cache
def asset(name: str) -> str:
    """Return the text of the file `name` in the folder `assets` of the pages."""
    return files("wavefield.explorer").joinpath(f"assets/{name}").read_text(encoding="utf-8")


def template(name: str) -> Template:
    """Return the HTML template in the file `name` of the folder `assets`; it escapes what it inserts."""
    return Environment(autoescape=True).from_string(asset(name))


def apply_template(
    document: Document,
    heading: str,
    command: str,
    places: Sequence[str],
    aspect: float = 1.3,
) -> None:
    """Set the HTML template of a Bokeh document, and its title from `heading` and `command`, such as "look".
    `places` are the names of the document's root elements. `aspect` is the width over the height of the map,
    which then fits into the height of the window."""
    document.title = f"{heading} – wavefield {command}"
    document.template = template("page.html")
    document.template_variables.update(
        heading=heading, command=command, places=list(places), css=asset("page.css"), script=asset("page.js"),
        keys=_KEYS if command == "look" else (), aspect=f"{aspect:.4f}",
    )  # fmt: skip
    document.js_on_event(ConnectionLost, CustomJS(code='document.getElementById("lost").hidden = false'))


# -- words ---------------------------------------------------------------------------------------------


def text_line(name: str, text: str = "", html: bool = False) -> Div:
    """Return a Bokeh paragraph of full width; with `html`, `text` is HTML that the caller has escaped."""
    raw = {"render_as_text": not html, "disable_math": True}
    return Div(text=text, name=name, sizing_mode="stretch_width", **raw)


def number(value: float, digits: int = 3) -> str:
    """Return a number as text with at most `digits` significant digits and a typographic minus sign."""
    return f"{value:.{digits}g}".replace("-", "\u2212")


def plain(words: object) -> str:
    """Return `words` as text for HTML: the characters that HTML reserves are escaped."""
    return escape(str(words), quote=False)


def alert(error: Exception) -> str:
    """Return the message of an error as HTML that screen readers announce."""
    return f'<span role="alert">{plain(error)}</span>'


def chosen(choice: Select) -> str:
    """Return the option that the user chose in a menu. If the browser sent a value that is not in the menu,
    return the first option, or "" if the menu has none."""
    values = [option if isinstance(option, str) else str(option[0]) for option in choice.options]
    return str(choice.value) if choice.value in values else next(iter(values), "")


def named(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return options for a menu of variables: pairs of name and displayed text, ("z", "z: elevation")."""
    return [(name, f"{name}: {TABLE[name].long_name}") for name in names]


# -- drawing -------------------------------------------------------------------------------------------


def draw_band(made: figure, source: ColumnDataSource, x: str, y: str, **line: object) -> None:
    """Draw a line through columns x, y of a source, and the band between its columns "low" and "high"."""
    made.varea(x, "low", "high", source=source, fill_color=BLUE, fill_alpha=0.22)
    made.line(x, y, source=source, **({"line_color": BLUE, "line_width": 1.6} | line))


def draw_ring(made: figure, source: ColumnDataSource, x: str, y: str, colour: str, size: int) -> None:
    """Draw a ring, `size` px wide, with a white outline around each point in columns x, y of a source."""
    for ring, width in (("white", 5.0), (colour, 2.3)):
        made.scatter(x, y, source=source, size=size, fill_color=None, line_color=ring, line_width=width)


def probe_columns(names: Sequence[str], x: Series, y: Series, middle: float) -> dict[str, list[object]]:
    """Return the columns of a source for `draw_probes`, for probes at x, y (n,), metres.
    Each name is written on the side towards `middle`, the x of the middle of the map, to stay on the map."""
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
    """Draw the masks in the source `saved`, and from `drawn` the corners of the mask that is being made."""
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
    """Return the Bokeh colour mapper for the quality of nodes, given as indices into `KINDS`."""
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
    """Return the columns of a source that draws values (ny, nx) as an image.
    The centres of its pixels are at x (nx,) and y (ny,)."""
    dx, dy = (float(v[-1] - v[0]) / max(len(v) - 1, 1) or 1.0 for v in (x, y))
    return {
        "image": [np.ascontiguousarray(values, np.float32)],
        "x": [float(x[0]) - dx / 2],
        "y": [float(y[0]) - dy / 2],
        "dw": [dx * len(x)],
        "dh": [dy * len(y)],
    }


# -- long series ---------------------------------------------------------------------------------------


def envelope(t: Series, value: Series, std: Series) -> dict[str, Series]:
    """Return the columns t, value, low and high that draw a series (n,) with a band of `std` on either side.
    Long series are thinned: of each bin of successive samples, only the lowest and the highest are kept, so
    that crests and troughs stay visible. The band of a bin encloses the bands of all its samples."""
    low, high = value - std, value + std
    if t.size > MOST_POINTS:
        width = -(-2 * t.size // MOST_POINTS)
        start = np.arange(0, t.size, width)
        padded = np.pad(value, (0, -t.size % width), constant_values=np.nan).reshape(-1, width)
        finite = np.isfinite(padded)
        lowest = start + np.where(finite, padded, np.inf).argmin(axis=1)
        highest = start + np.where(finite, padded, -np.inf).argmax(
            axis=1
        )  # of an empty bin, its first sample
        keep = np.unique(np.concatenate([lowest, highest]))
        t, value = t[keep], value[keep]
        low, high = (f.reduceat(edge, start)[keep // width] for f, edge in ((np.fmin, low), (np.fmax, high)))
    return {"t": t, "value": value, "low": low, "high": high}
