"""The map: any variable with arrows, adjustable colours, and what is picked on it."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from bokeh.events import PanEnd, PanStart
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    CustomJS,
    CustomJSHover,
    CustomJSTickFormatter,
    FixedTicker,
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

from wavefield.explorer import plot_parts as parts
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import arrows, colour_limits, palette, streamlines, top_speed
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import number
from wavefield.figures.display import display
from wavefield.figures.quality_kinds import KINDS, drawn_kind

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
_POWER = "return (10 ** tick).toPrecision(2) * 1"  # the labels of a logarithmic scale
_PAN = "move.active = cb_obj.value == 'move'; bar.active_drag = move.active ? move : null"


_WHERE = ("x, y", "$x{0.000}, $y{0.000} m")
Fields = Mapping[str, NDArray[np.float32]]


def map_aspect(ratio: float) -> float:
    """Width to height of a map with axes and colour bar that a field of this ratio fills at 900 px."""
    return float(np.clip(ratio * 900 / (768 + 60 * ratio), 0.8, 3.0))


def _scale(place: Place) -> tuple[str, str, bool]:
    """What has a colour scale of its own."""
    return place.show, place.averaged, place.log


class MapPanel:
    """The map of one variable."""

    def __init__(
        self, record: CubeRecord, drag: Select, picked: Callable[[str, tuple[float, ...]], None]
    ) -> None:
        self._record, self._drag, self._picked = record, drag, picked
        self._start: tuple[float, float] | None = None  # of the drag that goes on
        self._fitted: dict[tuple[str, str, bool], tuple[float, float]] = {}  # limits, by `_scale`
        self._fastest = 0.0  # speed of the longest arrows, m/s
        self.mapper = LinearColorMapper(palette=palette(display("w").colour_map), nan_color=parts.GREY)
        self.bar = parts.colour_bar(self.mapper)
        self.arrow_key = Label(
            x=8, y=8, x_units="screen", y_units="screen", text="", text_font_size="12px",
            background_fill_color="white", background_fill_alpha=0.8, padding=3,
        )  # fmt: skip
        self.sources = parts.make_sources(
            "map", image=parts.IMAGE, arrows="x y", node="x y", line="x y", area="left right bottom top",
            mask="x y", masks="xs ys", probes="x y name",
        )  # fmt: skip
        self.figure = self._draw()

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
        made.grid.grid_line_color = None
        made.background_fill_color = "#f6f8fa"
        image = made.image("image", source=source["image"], color_mapper=self.mapper)
        made.x_range.renderers = made.y_range.renderers = [image]
        made.line("x", "y", source=source["arrows"], color=parts.INK, line_width=1.1)
        for colour, line_width in (("white", 5.0), (parts.INK, 2.2)):
            made.line("x", "y", source=source["line"], line_cap="round", color=colour, line_width=line_width)
        made.quad(
            "left", "right", "bottom", "top", source=source["area"],
            fill_alpha=0.08, fill_color=parts.INK, line_color=parts.INK, line_width=2, line_dash=[6, 4],
        )  # fmt: skip
        parts.draw_masks(made, source["mask"], source["masks"])
        parts.draw_probes(made, source["probes"])
        parts.draw_ring(made, source["node"], "x", "y", parts.INK, 13)
        made.add_layout(self.bar, "right")
        made.add_layout(self.arrow_key)
        self.hover = HoverTool(renderers=[image])
        made.add_tools(self.hover)
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
        parts.on_click(made, lambda event: self._picked("node", (event.x, event.y)))
        self._drag.js_on_change("value", CustomJS(args={"bar": made.toolbar, "move": move}, code=_PAN))

    def _drag_begins(self, event: PanStart) -> None:
        self._start = (event.x, event.y)

    def _drag_ends(self, event: PanEnd) -> None:
        kind = {"line": "line", "rectangle": "area"}.get(self._drag.value)
        if kind and self._start and event.x is not None:
            self._picked(kind, (*self._start, event.x, event.y))

    # -- showing ---------------------------------------------------------------------------------------

    def show(self, place: Place, fields: Fields) -> None:
        """Draw fields (ny, nx) in stored units: that of a place, and u and v if there are any."""
        values = fields[place.show]
        if place.show == "quality":
            fresh = parts.quality_mapper()
            self.mapper.update(palette=fresh.palette, low=fresh.low, high=fresh.high)
            words = [words for _, words, _ in KINDS]
            ticks = FixedTicker(ticks=list(range(len(words))))
            self.bar.update(ticker=ticks, major_label_overrides=dict(enumerate(words)))
            self._name_values(place, f"return {words}[value] ?? 'none'")
            self.sources["image"].data = parts.image_data(drawn_kind(values), self._record.x, self._record.y)
        else:
            self._show_values(values * np.float32(display(place.show).factor), place)
        self._show_overlay(place, fields)

    def _show_values(self, values: NDArray[np.float32], place: Place) -> None:
        if _scale(place) not in self._fitted and np.isfinite(values).any():
            self._fitted[_scale(place)] = colour_limits(values, place.signed, place.log)
        low, high = place.limits or self.fitted(place)
        if place.log:
            with np.errstate(divide="ignore"):
                values = np.log10(np.abs(values))
            low, high = (float(np.log10(end)) for end in (low if low > 0 else 1e-4 * high, high))
        code = "10 ** value" if place.log else "value"
        if self._name_values(place, f"return Number(({code}).toPrecision(4))"):
            plain = parts.colour_bar(self.mapper)
            labels = CustomJSTickFormatter(code=_POWER) if place.log else plain.formatter
            self.bar.update(ticker=plain.ticker, formatter=labels, major_label_overrides={})
        colours = palette(place.colour_map)
        if self.mapper.palette != colours:  # 256 colours take 10 ms to check
            self.mapper.palette = colours
        self.mapper.update(low=low, high=high)
        self.sources["image"].data = parts.image_data(values, self._record.x, self._record.y)

    def _name_values(self, place: Place, code: str) -> bool:
        """Name what is under the pointer, its value by a script; returns whether it was named otherwise."""
        shown = display(place.show)
        words = f"{place.averaged} {shown.name}".strip()
        rows = [(f"|{words}|" if place.log else words, f"@image{{custom}} {shown.unit}")]
        changed = bool(self.hover.tooltips != [*rows, _WHERE])
        if changed:  # what is set is sent
            self.hover.formatters = {"@image": CustomJSHover(code=code)}
            self.hover.tooltips = [*rows, _WHERE]
        return changed

    def fitted(self, place: Place) -> tuple[float, float]:
        """Limits of the colour scale that fit what a place shows: those of its first step that was shown."""
        signed = display(place.show).signed and not place.log
        return self._fitted.get(_scale(place), (-1.0 if signed else 0.0, 1.0))

    def fitted_to(self, place: Place, values: NDArray[np.float32]) -> tuple[float, float]:
        """The same for a variable in stored units that the map has perhaps not shown yet."""
        if _scale(place) not in self._fitted and np.isfinite(values).any():
            shown = display(place.show)
            self._fitted[_scale(place)] = shown.limits(values * shown.factor)
        return self.fitted(place)

    def forget(self, place: Place) -> None:
        """Fit the colours, and the arrows, again to the next step that is shown."""
        self._fitted.pop(_scale(place), None)
        self._fastest = 0.0

    def _show_overlay(self, place: Place, fields: Fields) -> None:
        """Draw arrows or streamlines of u and v, of the step or of the mean flow."""
        self.arrow_key.text = ""
        if place.overlay == "nothing" or place.averaged == "rms" or not {"u", "v"} <= set(fields):
            parts.clear(self.sources["arrows"])
            return
        u, v, x, y = fields["u"], fields["v"], self._record.x, self._record.y
        if place.overlay == "streamlines":
            xs, ys = streamlines(u, v, x, y)
        else:
            fixed = place.averaged == "mean"  # others keep the scale of the first step that was shown
            fastest = top_speed(u, v) if fixed else self._fastest or top_speed(u, v)
            self._fastest = self._fastest or (0.0 if fixed else fastest)
            xs, ys, metres = arrows(u, v, x, y, fastest)
            speed = number(float(f"{100 * fastest:.1g}"))
            self.arrow_key.text = f"longest arrows: {speed} cm/s" if metres else ""
        self.sources["arrows"].data = {"x": xs, "y": ys}

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
