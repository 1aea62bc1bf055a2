"""The map: any variable with arrows, adjustable colours, and what is picked on it."""

from collections.abc import Callable, Sequence

import numpy as np
from bokeh.events import PanEnd, PanStart
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    CustomJS,
    HoverTool,
    Label,
    LinearColorMapper,
    PanTool,
    ResetTool,
    SaveTool,
    Select,
    WheelZoomTool,
    ZoomInTool,
    ZoomOutTool,
)
from bokeh.plotting import figure
from numpy.typing import NDArray

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import arrows, palette, top_speed
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import (
    GREY,
    IMAGE,
    INK,
    clear,
    colour_bar,
    draw_masks,
    draw_probes,
    draw_ring,
    image_data,
    label_kinds,
    make_figure,
    make_sources,
    number,
    on_click,
    quality_mapper,
)
from wavefield.figures.display import display
from wavefield.figures.quality import KINDS, quality_kind

# draws the line or the rectangle while it is dragged; Python gets it at the end
_DRAG = """
const kind = drag.value
if (kind != "line" && kind != "rectangle") return
if (cb_obj.event_name == "panstart") { start.data = {x: [cb_obj.x], y: [cb_obj.y]}; return }
const x0 = start.data.x[0], y0 = start.data.y[0], x1 = cb_obj.x, y1 = cb_obj.y
if (kind == "line") line.data = {x: [x0, x1], y: [y0, y1]}
else area.data = {left: [Math.min(x0, x1)], right: [Math.max(x0, x1)],
                  bottom: [Math.min(y0, y1)], top: [Math.max(y0, y1)]}
"""
_PAN = "move.active = cb_obj.value == 'move'; bar.active_drag = move.active ? move : null"


class MapPanel:
    """The map of one variable."""

    def __init__(
        self, record: CubeRecord, drag: Select, picked: Callable[[str, tuple[float, ...]], None]
    ) -> None:
        self._record, self._drag, self._picked = record, drag, picked
        self._start: tuple[float, float] | None = None  # of the drag that goes on
        self._fitted: dict[str, tuple[float, float]] = {}  # limits of the colour scales, by variable
        self._fastest = 0.0  # speed of the longest arrows, m/s
        self.mapper = LinearColorMapper(palette=palette(display("w").colour_map), nan_color=GREY)
        self.bar = colour_bar(self.mapper)
        self.arrow_key = Label(
            x=8, y=8, x_units="screen", y_units="screen", text="", text_font_size="12px",
            background_fill_color="white", background_fill_alpha=0.8, padding=3,
        )  # fmt: skip
        self.sources = make_sources(
            "map", image=IMAGE, arrows="x y", node="x y", line="x y", area="left right bottom top",
            mask="x y", masks="xs ys", probes="x y name",
        )  # fmt: skip
        self.figure = self._draw()

    def _draw(self) -> figure:
        record, source = self._record, self.sources
        width, height = float(np.ptp(record.x)) or 1.0, float(np.ptp(record.y)) or 1.0
        move, wheel = PanTool(), WheelZoomTool()
        zoom = BoxZoomTool(match_aspect=True), wheel, ZoomInTool(), ZoomOutTool()
        made = make_figure(
            "map", tools=[move, *zoom, ResetTool(), SaveTool()], active_scroll=wheel, active_drag=move,
            match_aspect=True, toolbar_location="above", x_axis_label="x (m)", y_axis_label="y (m)",
            aspect_ratio=float(np.clip(1.22 * width / height, 1.2, 2.4)),
        )  # fmt: skip
        made.x_range.range_padding = made.y_range.range_padding = 0.0
        made.grid.grid_line_color = None
        made.background_fill_color = "#f6f8fa"
        image = made.image("image", source=source["image"], color_mapper=self.mapper)
        made.x_range.renderers = made.y_range.renderers = [image]
        made.line("x", "y", source=source["arrows"], color=INK, line_width=1.1)
        for colour, line_width in (("white", 5.0), (INK, 2.2)):
            made.line("x", "y", source=source["line"], line_cap="round", color=colour, line_width=line_width)
        made.quad(
            "left", "right", "bottom", "top", source=source["area"],
            fill_alpha=0.08, fill_color=INK, line_color=INK, line_width=2, line_dash=[6, 4],
        )  # fmt: skip
        draw_masks(made, source["mask"], source["masks"])
        draw_probes(made, source["probes"])
        draw_ring(made, source["node"], "x", "y", INK, 13)
        made.add_layout(self.bar, "right")
        made.add_layout(self.arrow_key)
        made.add_tools(
            HoverTool(renderers=[image], tooltips=[("x, y", "$x{0.000}, $y{0.000} m"), ("", "@image")])
        )
        self._listen(made, move)
        return made

    def _listen(self, made: figure, move: PanTool) -> None:
        start = ColumnDataSource({"x": [0.0], "y": [0.0]})
        arguments = {"drag": self._drag, "start": start, "line": self.sources["line"]}
        follow = CustomJS(args=arguments | {"area": self.sources["area"]}, code=_DRAG)
        for event in ("panstart", "pan"):
            made.js_on_event(event, follow)
        made.on_event(PanStart, self._drag_begins)
        made.on_event(PanEnd, self._drag_ends)
        on_click(made, lambda event: self._picked("node", (event.x, event.y)))
        self._drag.js_on_change("value", CustomJS(args={"bar": made.toolbar, "move": move}, code=_PAN))

    def _drag_begins(self, event: PanStart) -> None:
        self._start = (event.x, event.y)

    def _drag_ends(self, event: PanEnd) -> None:
        kind = {"line": "line", "rectangle": "area"}.get(self._drag.value)
        if kind and self._start and event.x is not None:
            self._picked(kind, (*self._start, event.x, event.y))

    # -- showing ---------------------------------------------------------------------------------------

    def show(self, place: Place) -> None:
        """Draw a step."""
        values = self._record.field(place.show, place.step)
        if place.show == "quality":
            kinds = quality_kind(values).astype(np.float32)
            kinds[kinds == len(KINDS)] = np.nan
            fresh = quality_mapper()
            self.mapper.update(palette=fresh.palette, low=fresh.low, high=fresh.high)
            label_kinds(self.bar)
            self.sources["image"].data = image_data(kinds, self._record.x, self._record.y)
        else:
            self._show_values(values * np.float32(display(place.show).factor), place)
        self._show_arrows(place)

    def _show_values(self, values: NDArray[np.float32], place: Place) -> None:
        if place.show not in self._fitted and np.isfinite(values).any():
            self._fitted[place.show] = display(place.show).limits(values)
        low, high = place.limits or self.fitted(place.show)
        if self.bar.major_label_overrides:  # those of the kinds of quality
            self.bar.update(ticker=colour_bar(self.mapper).ticker, major_label_overrides={})
        self.mapper.update(palette=palette(display(place.show).colour_map), low=low, high=high)
        self.sources["image"].data = image_data(values, self._record.x, self._record.y)

    def fitted(self, name: str) -> tuple[float, float]:
        """Limits of the colour scale that fit a variable: those of the first step that was shown."""
        return self._fitted.get(name, (-1.0 if display(name).signed else 0.0, 1.0))

    def forget(self, name: str) -> None:
        """Fit the colours of a variable, and the arrows, again to the next step that is shown."""
        self._fitted.pop(name, None)
        self._fastest = 0.0

    def _show_arrows(self, place: Place) -> None:
        record = self._record
        if not place.arrows or not {"u", "v"} <= set(record.stored):
            clear(self.sources["arrows"])
            self.arrow_key.text = ""
            return
        u, v = record.field("u", place.step), record.field("v", place.step)
        self._fastest = self._fastest or top_speed(u, v)
        xs, ys, metres = arrows(u, v, record.x, record.y, self._fastest)
        self.sources["arrows"].data = {"x": xs, "y": ys}
        speed = float(f"{100 * self._fastest:.1g}")
        self.arrow_key.text = f"longest arrows: {number(speed)} cm/s" if metres else ""

    def mark(self, place: Place) -> None:
        """Draw what is picked."""
        x0, y0, x1, y1 = place.area or (0.0, 0.0, 0.0, 0.0)
        corners = {"left": min(x0, x1), "right": max(x0, x1), "bottom": min(y0, y1), "top": max(y0, y1)}
        node, line = place.node or (), place.line or ()
        marks: dict[str, dict[str, list[float]]] = {
            "node": {"x": list(node[:1]), "y": list(node[1:])},
            "line": {"x": list(line[::2]), "y": list(line[1::2])},
            "area": {name: [value] if place.area else [] for name, value in corners.items()},
        }
        for key, data in marks.items():
            if dict(self.sources[key].data) != data:  # each source that is sent is painted
                self.sources[key].data = data

    def mark_probes(self, names: Sequence[str], x: Sequence[float], y: Sequence[float]) -> None:
        """Draw the positions of probes, metres."""
        self.sources["probes"].data = {"x": list(x), "y": list(y), "name": list(names)}
