"""Along a line: the shown variable now, and as it goes by."""

import numpy as np
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, Div, LinearColorMapper, Range1d, Span

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import colour_map, palette, shown_as
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import (
    BLUE,
    GREY,
    INK,
    colour_bar,
    image_data,
    image_source,
    make_figure,
    number,
)
from wavefield.explorer.selections import interpolate, line_points, time_distance

_STEPS = 400  # of the time-distance diagram, about the moment shown


class LinePanel:
    """Transect and time-distance diagram."""

    def __init__(self, record: CubeRecord) -> None:
        self._record = record
        self.words = Div(
            text="Choose \u201cline\u201d for dragging (key L) and drag across the map.",
            name="line_words", sizing_mode="stretch_width",
        )  # fmt: skip
        self.now = ColumnDataSource({"s": [], "value": []}, name="line_now")
        self.transect = make_figure("line_transect", height=230, tools="pan,wheel_zoom,reset")
        self.transect.line("s", "value", source=self.now, color=BLUE, line_width=1.8)
        self.mapper = LinearColorMapper(palette=palette(colour_map("w")), nan_color=GREY)
        self.image = image_source("line_image")
        self.diagram = make_figure(
            "line_diagram",
            height=430,
            tools="pan,wheel_zoom,reset,save",
            toolbar_location="above",
            x_range=self.transect.x_range,
            y_range=Range1d(0, 1),
            x_axis_label="distance along the line (m)",
            y_axis_label="t (s)",
        )
        self.diagram.grid.grid_line_color = None
        self.diagram.image("image", source=self.image, color_mapper=self.mapper)
        self.moment = Span(dimension="width", location=0, line_color=INK, line_dash="dotted")
        self.diagram.add_layout(self.moment)
        self.bar = colour_bar(self.mapper)
        self.diagram.add_layout(self.bar, "right")
        self._window: tuple[int, int] | None = None
        self._drawn: tuple[object, ...] = ()
        self.layout = column(self.words, self.transect, self.diagram, sizing_mode="stretch_width")

    def show(self, place: Place, limits: tuple[float, float]) -> None:
        """Show the line of a place.

        With limits (float, float).
        """
        if place.line is None:
            return
        record, preview = self._record, self._record.preview
        name = "w" if place.show == "quality" else place.show
        shown = shown_as(name, record.units(name))
        start, end = place.line[:2], place.line[2:]
        spacing = float(np.mean(np.diff(record.x)))
        distance, x, y = line_points(start, end, spacing)
        values = interpolate(record.field(name, place.step), record.x, record.y, x, y) * shown.factor
        self.now.data = {"s": distance, "value": values}
        self.transect.yaxis.axis_label = f"{name}{shown.suffix}"
        self.words.text = (
            f"<b>From ({number(start[0])}, {number(start[1])}) m to ({number(end[0])}, {number(end[1])}) m"
            f"</b>, {number(float(distance[-1]))} m; below: as it goes by; dotted: t "
            f"{record.time[place.step]:.3f} s."
        )
        self.moment.location = float(record.time[place.step])
        if name not in preview.thin.names:
            self.image.data = {key: [] for key in self.image.data}
            self.diagram.title.text = f"no diagram of {name}: it is computed step by step"
            return
        self._show_diagram(place, name, limits, x, y)

    def _show_diagram(
        self, place: Place, name: str, limits: tuple[float, float], x: np.ndarray, y: np.ndarray
    ) -> None:
        record, preview = self._record, self._record.preview
        low = int(np.clip(place.step - _STEPS // 2, 0, max(0, record.layout.steps - _STEPS)))
        steps = slice(low, min(low + _STEPS, record.layout.steps))
        shown = shown_as(name, record.units(name))
        self.mapper.update(palette=palette(colour_map(name)), low=limits[0], high=limits[1])
        self.diagram.title.text = f"{name}{shown.suffix}"
        around = self._window and self._window[0] <= place.step < self._window[1]
        key = (place.line, name, int(preview.known.sum()))
        if around and self._drawn == key and self._quarter(place.step):
            return  # still well inside what is drawn
        values = time_distance(
            preview.stored(name)[..., steps], preview.scale(name), preview.x, preview.y, x, y
        )
        length = float(np.hypot(x[-1] - x[0], y[-1] - y[0]))
        along = np.linspace(0.0, length, values.shape[1])
        self.image.data = image_data(values * np.float32(shown.factor), along, record.time[steps])
        self.diagram.y_range.update(start=float(record.time[steps][0]), end=float(record.time[steps][-1]))
        self._window, self._drawn = (steps.start, steps.stop), key

    def _quarter(self, step: int) -> bool:
        assert self._window is not None
        first, last = self._window
        quarter = (last - first) // 4
        low = first == 0 or step >= first + quarter
        high = last == self._record.layout.steps or step < last - quarter
        return low and high
