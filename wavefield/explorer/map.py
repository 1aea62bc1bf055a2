"""The map of one variable, with arrows of the horizontal velocity."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    CustomJSHover,
    FixedTicker,
    GlyphRenderer,
    HoverTool,
    Label,
    LinearColorMapper,
    PanTool,
    ResetTool,
    SaveTool,
    WheelZoomTool,
    ZoomInTool,
    ZoomOutTool,
)
from bokeh.plotting import figure
from numpy.typing import NDArray

from wavefield.explorer import parts
from wavefield.explorer.parts import Place, number
from wavefield.explorer.record import CubeRecord
from wavefield.figures.display import KINDS, display, drawn_kind, limit, thin

Field = NDArray[np.floating]
_WHERE = ("x, y", "$x{0.000}, $y{0.000} m")


def map_aspect(ratio: float) -> float:
    """Return width over height of a figure with a map and margins; `ratio` is width over height of the field.
    The margins are those of a figure 900 px wide. The result is between 0.8 and 3."""
    return float(np.clip(ratio * 900 / (768 + 60 * ratio), 0.8, 3.0))


def top_speed(u: Field, v: Field) -> float:
    """Return the 98 % quantile of horizontal speed, m/s, from u, v (ny, nx), m/s; 0 if all are NaN."""
    speed = np.hypot(u, v)
    return limit(speed, 98) if np.isfinite(speed).any() else 0.0


def arrows(u: Field, v: Field, x: Field, y: Field, fastest: float) -> tuple[Field, Field, float]:
    """Return x and y (7 n,), m, of lines that draw n velocity arrows, and their length per speed, m per m/s.
    u, v (ny, nx), m/s, are the velocity at x (nx,), y (ny,), m; only every few nodes get an arrow. An arrow
    takes six points and a NaN. Its length for the speed `fastest`, m/s, is 1.2 times the arrows' spacing."""
    some = thin(len(x), len(y))
    gap = some.step * float(np.mean(np.diff(x)))
    metres = 1.2 * gap / fastest if fastest > 0 else 0.0
    px, py = np.meshgrid(x[some], y[some])
    dx, dy = metres * u[some, some], metres * v[some, some]
    drawn = np.hypot(dx, dy) > 0.04 * gap  # False where NaN
    px, py, dx, dy = (part[drawn] for part in (px, py, dx, dy))
    tip_x, tip_y, end = px + dx, py + dy, np.full_like(px, np.nan)
    left_x, left_y = tip_x - dx / 3 + dy / 6, tip_y - dy / 3 - dx / 6  # the head is a third of the arrow
    right_x, right_y = tip_x - dx / 3 - dy / 6, tip_y - dy / 3 + dx / 6
    xs = np.array([px, tip_x, left_x, tip_x, right_x, tip_x, end])
    ys = np.array([py, tip_y, left_y, tip_y, right_y, tip_y, end])
    return xs.T.ravel(), ys.T.ravel(), metres


def draw_layers(
    made: figure, sources: Mapping[str, ColumnDataSource], mapper: LinearColorMapper
) -> GlyphRenderer:
    """Draw the sources "image", "arrows" and "probes" on a figure; return Bokeh's renderer of the image."""
    made.grid.grid_line_color = None
    image = made.image("image", source=sources["image"], color_mapper=mapper)
    made.x_range.renderers = made.y_range.renderers = [image]
    made.line("x", "y", source=sources["arrows"], color=parts.INK, line_width=1.1)
    parts.draw_probes(made, sources["probes"])
    return image


class MapPanel:
    """The map of one variable of a cube; `picked` is called with x and y, m, when the user clicks on it."""

    def __init__(self, record: CubeRecord, picked: Callable[[float, float], None]) -> None:
        self._record = record
        self._fitted: dict[str, tuple[float, float]] = {}  # limits of the colours, by variable
        self._fastest = 0.0  # speed of the longest arrows, m/s
        self.mapper = LinearColorMapper(palette=parts.palette("RdBu_r"), nan_color=parts.GREY)
        self.bar = parts.colour_bar(self.mapper)
        self.arrow_key = Label(
            x=8, y=8, x_units="screen", y_units="screen", text="", text_font_size="12px",
            background_fill_color="white", background_fill_alpha=0.8, padding=3,
        )  # fmt: skip
        self.sources = parts.make_sources(
            "map", image=parts.IMAGE, arrows="x y", node="x y", mask="x y", masks="xs ys",
            probes="x y name align offset",
        )  # fmt: skip
        self.layout = self._draw()
        parts.on_click(self.layout, lambda event: picked(event.x, event.y))

    def _draw(self) -> figure:
        record, source = self._record, self.sources
        width, height = float(np.ptp(record.x)) or 1.0, float(np.ptp(record.y)) or 1.0
        move, wheel = PanTool(), WheelZoomTool()
        zoom = BoxZoomTool(match_aspect=True), wheel, ZoomInTool(), ZoomOutTool()
        made = parts.make_figure(
            "map", tools=[move, *zoom, ResetTool(), SaveTool()], active_scroll=wheel, active_drag=move,
            match_aspect=True, toolbar_location="above", x_axis_label="x (m)", y_axis_label="y (m)",
            aspect_ratio=map_aspect(width / height),
        )  # fmt: skip
        made.x_range.range_padding = made.y_range.range_padding = 0.0
        made.background_fill_color = "#f6f8fa"
        image = draw_layers(made, source, self.mapper)
        parts.draw_masks(made, source["mask"], source["masks"])
        parts.draw_ring(made, source["node"], "x", "y", parts.INK, 13)
        made.add_layout(self.bar, "right")
        made.add_layout(self.arrow_key)
        self.hover = HoverTool(renderers=[image])
        made.add_tools(self.hover)
        return made

    # -- showing ---------------------------------------------------------------------------------------

    def show(self, place: Place) -> None:
        """Draw the variable and step in `place`, the state of the page, with arrows and the picked node."""
        record, shown = self._record, display(place.show)
        values = record.field(place.show, place.step)
        if place.show == "quality":
            fresh = parts.quality_mapper()
            self.mapper.update(palette=fresh.palette, low=fresh.low, high=fresh.high)
            words = [words for _, words, _ in KINDS]
            ticks = FixedTicker(ticks=list(range(len(words))))
            self.bar.update(ticker=ticks, major_label_overrides=dict(enumerate(words)))
            self._name_values(place, f"return {words}[value] ?? 'none'")
            drawn = drawn_kind(values)
        else:
            drawn = values * np.float32(shown.factor)
            low, high = self.limits(place)
            if self._name_values(place, "return Number(value.toPrecision(4))"):
                self.bar.update(ticker=parts.colour_bar(self.mapper).ticker, major_label_overrides={})
            colours = parts.palette(shown.colour_map)
            if self.mapper.palette != colours:  # 256 colours take 10 ms to check
                self.mapper.palette = colours
            self.mapper.update(low=low, high=high)
        self.sources["image"].data = parts.image_data(drawn, record.x, record.y)
        self._show_arrows(place)
        self.mark(place.node)

    def _name_values(self, place: Place, code: str) -> bool:
        """Make the map's tooltip show the variable in `place`; the JavaScript `code` formats its values.
        Return whether the tooltip changed."""
        shown = display(place.show)
        rows = [(shown.name, f"@image{{custom}} {shown.unit}"), _WHERE]
        changed = bool(self.hover.tooltips != rows)
        if changed:  # every assignment is sent to the browser
            self.hover.formatters = {"@image": CustomJSHover(code=code)}
            self.hover.tooltips = rows
        return changed

    def limits(self, place: Place) -> tuple[float, float]:
        """Return the lower and upper limit of the colour scale, in the displayed unit, that the user entered.
        By default they fit the first drawn step with values of the variable; until then (-1, 1)."""
        name = place.show
        if name not in self._fitted:
            values = self._record.field(name, place.step)
            if not np.isfinite(values).any():
                return place.limits or (-1.0, 1.0)
            shown = display(name)
            self._fitted[name] = shown.limits(values * shown.factor)
        return place.limits or self._fitted[name]

    def refit(self, place: Place) -> None:
        """Forget the automatic scale of the arrows and the automatic colour scale of the variable in `place`.
        The next step that is drawn sets both scales again."""
        self._fitted.pop(place.show, None)
        self._fastest = 0.0

    def _show_arrows(self, place: Place) -> None:
        record = self._record
        self.arrow_key.text = ""
        if place.overlay == "nothing" or not {"u", "v"} <= set(record.stored):
            parts.clear(self.sources["arrows"])
            return
        u, v = (record.field(name, place.step) for name in "uv")
        self._fastest = self._fastest or top_speed(u, v)  # of the first step that is shown
        xs, ys, metres = arrows(u, v, record.x, record.y, self._fastest)
        speed = number(float(f"{100 * self._fastest:.1g}"))
        self.arrow_key.text = f"longest arrows: {speed} cm/s" if metres else ""
        self.sources["arrows"].data = {"x": xs, "y": ys}

    def mark(self, node: tuple[float, float] | None) -> None:
        """Draw a ring at the picked node (x, y), metres; None removes it."""
        data = {"x": [node[0]], "y": [node[1]]} if node else {"x": [], "y": []}
        if dict(self.sources["node"].data) != data:  # the browser repaints every source that it receives
            self.sources["node"].data = data

    def mark_probes(self, names: Sequence[str], x: Field, y: Field) -> None:
        """Draw probes with their names at x, y (n,), metres."""
        self.sources["probes"].data = parts.probe_columns(names, x, y, float(np.mean(self._record.x)))
