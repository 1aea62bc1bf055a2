"""Along a line: the displayed variable now, and over time."""

import numpy as np
from bokeh.layouts import column
from bokeh.models import LinearColorMapper, Range1d, Span
from numpy.typing import NDArray

from wavefield.explorer import plot_parts as parts
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import palette
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import number
from wavefield.explorer.selections import interpolate, line_points, time_distance
from wavefield.figures.display import display

_DIAGRAM_STEPS = 400  # of the time-distance diagram, about the displayed step


class LinePanel:
    """Transect and time-distance diagram."""

    def __init__(self, record: CubeRecord, limits: parts.Limits) -> None:
        self._record, self._limits = record, limits
        self._window = (0, 0)  # steps of the diagram
        self._drawn: tuple[object, ...] = ()
        self.words = parts.words_of(
            "line_words", "Choose “line” for dragging (key L) and drag across the map.", html=True
        )
        self.sources = parts.make_sources("line", now="s value", image=parts.IMAGE)
        labels = 56  # px for those of the colour bar, which become longer with the values
        self.transect = parts.make_figure(
            "line_transect", height=230, tools="pan,wheel_zoom,reset", min_border_right=labels
        )
        self.transect.line("s", "value", source=self.sources["now"], color=parts.BLUE, line_width=1.8)
        parts.add_hover(self.transect, mode="vline")
        self.mapper = LinearColorMapper(palette=palette(display("w").colour_map), nan_color=parts.GREY)
        self.diagram = parts.make_figure(
            "line_diagram", height=430, tools="pan,wheel_zoom,reset,save", toolbar_location="above",
            x_range=self.transect.x_range, y_range=Range1d(0, 1), min_border_right=labels,
            x_axis_label="distance along the line (m)", y_axis_label="t (s)",
        )  # fmt: skip
        self.diagram.grid.grid_line_color = None
        self.diagram.image("image", source=self.sources["image"], color_mapper=self.mapper)
        parts.add_hover(self.diagram)
        self.moment = Span(dimension="width", location=0, line_color=parts.INK, line_dash="dotted")
        self.diagram.add_layout(self.moment)
        self.diagram.add_layout(parts.colour_bar(self.mapper), "right")
        self.layout = column(self.words, self.transect, self.diagram, sizing_mode="stretch_width")

    def show(self, place: Place) -> None:
        """Show the line of a place."""
        if place.line is None:
            return
        record, name, time = self._record, place.coloured, float(self._record.time[place.step])
        shown = display(name)
        start, end = place.line[:2], place.line[2:]
        distance, x, y = line_points(start, end, float(np.mean(np.diff(record.x))))
        values = interpolate(record.field(name, place.step), record.x, record.y, x, y) * shown.factor
        self.sources["now"].data = {"s": distance, "value": values}
        self.transect.yaxis.axis_label = shown.label
        self.transect.hover.tooltips = [
            ("along the line", "@s{0.000} m"),
            (name, f"@value{{0.[000]}} {shown.unit}"),
        ]
        self.diagram.hover.tooltips = [
            ("along the line, t", "$x{0.000} m, $y{0.000} s"),
            (name, f"@image{{0.[000]}} {shown.unit}"),
        ]
        self.words.text = (
            f"<b>From ({number(start[0])}, {number(start[1])}) m to ({number(end[0])}, {number(end[1])}) m"
            f"</b>, {number(float(distance[-1]))} m. Below: space-time plot; dotted: t {time:.3f} s."
        )
        self.moment.location = time
        if name not in record.preview.thin.names:
            parts.clear(self.sources["image"])
            self.diagram.title.text = f"no diagram of {name}: it is computed step by step"
            return
        low, high = self._limits(place)
        self.mapper.update(palette=palette(place.colours or shown.colour_map), low=low, high=high)
        self.diagram.title.text = shown.label
        drawn = (place.line, name, record.preview.count)
        if self._drawn != drawn or not self._well_inside(place.step):
            self._drawn = drawn
            self._show_diagram(place.step, name, x, y)

    def _show_diagram(self, step: int, name: str, x: NDArray[np.floating], y: NDArray[np.floating]) -> None:
        record, preview = self._record, self._record.preview
        low = int(np.clip(step - _DIAGRAM_STEPS // 2, 0, max(0, record.layout.steps - _DIAGRAM_STEPS)))
        steps = slice(low, min(low + _DIAGRAM_STEPS, record.layout.steps))
        values = time_distance(
            preview.stored(name)[..., steps],
            preview.scale(name),
            preview.x,
            preview.y,
            x,
            y,
        )
        along = np.linspace(0.0, float(np.hypot(x[-1] - x[0], y[-1] - y[0])), values.shape[1])
        time = record.time[steps]
        self.sources["image"].data = parts.image_data(values * np.float32(display(name).factor), along, time)
        self.diagram.y_range.update(start=float(time[0]), end=float(time[-1]))
        self._window = steps.start, steps.stop

    def _well_inside(self, step: int) -> bool:
        """Whether a step is in the middle half of the diagram, or at an end of the record."""
        first, last = self._window
        quarter = (last - first) // 4
        after_start = first == 0 or step >= first + quarter
        before_end = last == self._record.layout.steps or step < last - quarter
        return first <= step < last and after_start and before_end
