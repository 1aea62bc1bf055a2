"""The map: any variable with arrows, colours that can be set, and what has been picked on it."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from bokeh.events import DoubleTap, PanEnd, PanStart, Tap
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
    WheelZoomTool,
    ZoomInTool,
    ZoomOutTool,
)

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import arrows, colour_limits, colour_map, palette, shown_as
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import (
    GREY,
    INK,
    colour_bar,
    draw_masks,
    fixed_labels,
    image_data,
    image_source,
    make_figure,
    number,
)
from wavefield.figures.quality import KINDS, quality_kind
from wavefield.figures.style import limit

Point = tuple[float, float]

# draws the line or the rectangle while it is dragged; python hears of it at the end
_DRAG = """
const kind = drag.value
if (kind != "line" && kind != "rectangle") return
if (cb_obj.event_name == "panstart") { start.data = {x: [cb_obj.x], y: [cb_obj.y]}; return }
const x0 = start.data.x[0], y0 = start.data.y[0], x1 = cb_obj.x, y1 = cb_obj.y
if (kind == "line") line.data = {x: [x0, x1], y: [y0, y1]}
else area.data = {left: [Math.min(x0, x1)], right: [Math.max(x0, x1)],
                  bottom: [Math.min(y0, y1)], top: [Math.max(y0, y1)]}
"""


class MapPanel:
    """The map of one variable."""

    def __init__(
        self, record: CubeRecord, drag: Any, picked: Callable[[str, tuple[float, ...]], None]
    ) -> None:
        self._record, self._drag, self._picked = record, drag, picked
        self._start: Point | None = None
        self._palettes = {name: palette(name) for name in {colour_map(n) for n in record.names}}
        self._fitted: dict[str, tuple[float, float]] = {}
        self._fastest = 0.0
        self.mapper = LinearColorMapper(palette=self._palettes[colour_map("w")], nan_color=GREY)
        self.image = image_source("map_image")
        self.shafts = ColumnDataSource({"x": [], "y": []}, name="map_arrows")
        self.node = ColumnDataSource({"x": [], "y": []}, name="map_node")
        self.line = ColumnDataSource({"x": [], "y": []}, name="map_line")
        self.area = ColumnDataSource({"left": [], "right": [], "bottom": [], "top": []}, name="map_area")
        self.mask = ColumnDataSource({"x": [], "y": []}, name="map_mask")
        self.masks = ColumnDataSource({"xs": [], "ys": []}, name="map_masks")
        self.probes = ColumnDataSource({"x": [], "y": [], "name": []}, name="map_probes")
        self.figure = self._draw()

    def _draw(self) -> Any:
        record = self._record
        wide, high = float(np.ptp(record.x)) or 1.0, float(np.ptp(record.y)) or 1.0
        move, wheel = PanTool(), WheelZoomTool()
        made = make_figure(
            "map",
            tools=[
                move,
                wheel,
                BoxZoomTool(match_aspect=True),
                ZoomInTool(),
                ZoomOutTool(),
                ResetTool(),
                SaveTool(),
            ],
            active_scroll=wheel,
            active_drag=move,
            match_aspect=True,
            toolbar_location="above",
            x_axis_label="x (m)",
            y_axis_label="y (m)",
            aspect_ratio=float(np.clip(1.22 * wide / high, 1.2, 2.4)),
        )
        made.x_range.range_padding = made.y_range.range_padding = 0.0
        made.grid.grid_line_color = None
        made.background_fill_color = "#f6f8fa"
        shown = made.image("image", source=self.image, color_mapper=self.mapper)
        made.x_range.renderers = made.y_range.renderers = [shown]
        made.line("x", "y", source=self.shafts, color=INK, line_width=1.1)
        halo: dict[str, Any] = {"source": self.line, "line_cap": "round"}
        made.line("x", "y", color="white", line_width=5, **halo)
        made.line("x", "y", color=INK, line_width=2.2, **halo)
        made.quad(
            "left", "right", "bottom", "top", source=self.area,
            fill_alpha=0.08, fill_color=INK, line_color=INK, line_width=2, line_dash=[6, 4],
        )  # fmt: skip
        draw_masks(made, self.mask, self.masks)
        made.scatter(
            "x", "y", source=self.probes, marker="triangle", size=11, fill_color="#F0E442", line_color=INK
        )
        made.text("x", "y", "name", source=self.probes, x_offset=8, y_offset=4, text_font_size="11px")
        made.scatter("x", "y", source=self.node, size=13, fill_color=None, line_color="white", line_width=5)
        made.scatter("x", "y", source=self.node, size=13, fill_color=None, line_color=INK, line_width=2.2)
        self.bar = colour_bar(self.mapper)
        made.add_layout(self.bar, "right")
        self.key = Label(
            x=8, y=8, x_units="screen", y_units="screen", text="", text_font_size="12px",
            background_fill_color="white", background_fill_alpha=0.8, padding=3,
        )  # fmt: skip
        made.add_layout(self.key)
        made.add_tools(
            HoverTool(renderers=[shown], tooltips=[("x, y", "$x{0.000}, $y{0.000} m"), ("", "@image")])
        )
        self._move = move
        self._listen(made)
        return made

    def _listen(self, made: Any) -> None:
        start = ColumnDataSource({"x": [0.0], "y": [0.0]})
        follow = CustomJS(
            args={"drag": self._drag, "start": start, "line": self.line, "area": self.area}, code=_DRAG
        )
        for event in ("panstart", "pan"):
            made.js_on_event(event, follow)
        made.on_event(PanStart, self._drag_begins)
        made.on_event(PanEnd, self._drag_ends)
        for tap in (Tap, DoubleTap):  # a second click within .3 s is no tap, wherever it is
            made.on_event(tap, self._tapped)
        self._drag.js_on_change(
            "value",
            CustomJS(
                args={"bar": made.toolbar, "move": self._move},
                code="move.active = cb_obj.value == 'move'; bar.active_drag = move.active ? move : null",
            ),
        )

    def _drag_begins(self, event: Any) -> None:
        self._start = (event.x, event.y)

    def _drag_ends(self, event: Any) -> None:
        kind = {"line": "line", "rectangle": "area"}.get(self._drag.value)
        if kind and self._start and event.x is not None:
            self._picked(kind, (*self._start, event.x, event.y))

    def _tapped(self, event: Any) -> None:
        self._picked("node", (event.x, event.y))

    # -- showing ---------------------------------------------------------------------------------------

    def show(self, place: Place) -> None:
        """Draw a step."""
        values = self._record.field(place.show, place.step)
        if place.show == "quality":
            self._show_kinds(values)
        else:
            self._show_values(values, place)
        self._show_arrows(place)

    def _show_kinds(self, quality: Any) -> None:
        kinds = quality_kind(quality).astype(np.float32)
        kinds[kinds == len(KINDS)] = np.nan
        self.mapper.update(palette=[k[2] for k in KINDS], low=-0.5, high=len(KINDS) - 0.5)
        fixed_labels(self.bar, [k[1] for k in KINDS])
        self.image.data = image_data(kinds, self._record.x, self._record.y)

    def _show_values(self, values: Any, place: Place) -> None:
        shown = shown_as(place.show, self._record.units(place.show))
        values = values * np.float32(shown.factor)
        low, high = place.limits or self.fitting(place.show, values)
        if self.bar.major_label_overrides:
            fresh = colour_bar(self.mapper)
            self.bar.update(ticker=fresh.ticker, major_label_overrides={})
        self.mapper.update(palette=self._palettes[colour_map(place.show)], low=low, high=high)
        self.image.data = image_data(values, self._record.x, self._record.y)

    def fitting(self, name: str, values: Any = None) -> tuple[float, float]:
        """Ends of the colour scale that fit a variable; kept from step to step."""
        if name not in self._fitted and values is not None:
            if not np.isfinite(values).any():
                return colour_limits(values, name)
            self._fitted[name] = colour_limits(values, name)
        return self._fitted.get(name, (-1.0, 1.0))

    def forget(self, name: str) -> None:
        """Fit the colours of a variable again at the next step that is shown."""
        self._fitted.pop(name, None)
        self._fastest = 0.0

    def _show_arrows(self, place: Place) -> None:
        record = self._record
        if not place.arrows or not {"u", "v"} <= set(record.stored):
            self.shafts.data = {"x": [], "y": []}
            self.key.text = ""
            return
        u, v = record.field("u", place.step), record.field("v", place.step)
        if not self._fastest:
            speed = np.hypot(u, v)
            self._fastest = limit(speed, 98) if np.isfinite(speed).any() else 0.0
        xs, ys, metres = arrows(u, v, record.x, record.y, self._fastest)
        self.shafts.data = {"x": xs, "y": ys}
        key = float(f"{100 * self._fastest:.1g}")
        self.key.text = f"longest arrows: {number(key)} cm/s" if metres else ""

    def mark(self, place: Place) -> None:
        """Draw what has been picked."""
        line, corners = place.line or (), _corners(place.area)
        marks: list[tuple[ColumnDataSource, dict[str, list[float]]]] = [
            (self.node, {"x": [place.node[0]], "y": [place.node[1]]} if place.node else {"x": [], "y": []}),
            (self.line, {"x": list(line[::2]), "y": list(line[1::2])}),
            (self.area, {name: [value] if place.area else [] for name, value in corners.items()}),
        ]
        for source, data in marks:
            if dict(source.data) != data:  # each one that is sent is painted
                source.data = data

    def mark_probes(self, names: Sequence[str], x: Sequence[float], y: Sequence[float]) -> None:
        """Draw where probes stand."""
        self.probes.data = {"x": list(x), "y": list(y), "name": list(names)}


def _corners(area: Sequence[float] | None) -> dict[str, float]:
    x0, y0, x1, y1 = area or (0.0, 0.0, 0.0, 0.0)
    return {"left": min(x0, x1), "right": max(x0, x1), "bottom": min(y0, y1), "top": max(y0, y1)}
