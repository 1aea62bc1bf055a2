"""The surface in three dimensions, turned with the mouse: projected in the browser, without a round trip."""

import numpy as np
from bokeh.models import CustomJS, Label, LinearColorMapper

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import palette, relief
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import GREY, INK, Limits, colour_bar, make_figure, make_sources, number
from wavefield.explorer.template import asset
from wavefield.figures.display import display, limit

INITIAL_VIEW = {"turn": [-0.7], "tilt": [0.62]}  # radians
_LIFT = 0.1  # height of the highest water, in diagonals of the grid
_MOST_LIFT = 1e4  # of what is not flat


class SurfacePanel:
    """The relief of z, coloured by the displayed variable."""

    def __init__(self, record: CubeRecord, limits: Limits) -> None:
        self._record, self._limits = record, limits
        self._highest = 0.0  # of z at the first step that is shown, m
        self._diagonal = float(np.hypot(np.ptp(record.x), np.ptp(record.y)))
        self.sources = make_sources(
            "surface", field="x y height value", quads="xs ys value", frame="x y", words="x y text",
            view="turn tilt",
        )  # fmt: skip
        self.sources["view"].data = INITIAL_VIEW
        self.mapper = LinearColorMapper(
            palette=palette(display("w").colour_map), low=-1, high=1, nan_color=GREY
        )
        size = 0.56 * self._diagonal
        made = make_figure(
            "surface", tools="wheel_zoom,reset,save", toolbar_location="above", aspect_ratio=1.4,
            x_range=(-size, size), y_range=(-0.72 * size, 0.72 * size),
            x_axis_type=None, y_axis_type=None, min_border_left=4,
        )  # fmt: skip
        made.grid.grid_line_color = None
        made.line("x", "y", source=self.sources["frame"], color="#8b949e", line_dash=[5, 4], line_width=1.3)
        colour = {"field": "value", "transform": self.mapper}
        made.patches(
            "xs", "ys", source=self.sources["quads"], fill_color=colour, line_color=colour, line_width=0.6
        )
        made.text(
            "x", "y", "text", source=self.sources["words"], text_align="center", text_baseline="middle",
            text_color=INK,
        )  # fmt: skip
        made.add_layout(colour_bar(self.mapper), "right")
        self.note = Label(x=8, y=8, x_units="screen", y_units="screen", text="", text_font_size="12px")
        made.add_layout(self.note)
        project = CustomJS(args=self.sources, code=asset("relief.js"))
        for changed in (self.sources["field"], self.sources["view"]):
            changed.js_on_change("data", project)
        for event in ("panstart", "pan"):
            made.js_on_event(event, project)
        self.layout = made

    def show(self, place: Place) -> None:
        """Draw a step."""
        record, shown = self._record, display(place.coloured)
        z, x, y = relief(record.field("z", place.step), record.x, record.y)
        values, _, _ = relief(record.field(shown.name, place.step), record.x, record.y)
        if not self._highest and np.isfinite(z).any():
            self._highest = limit(z)
        lift = _LIFT * self._diagonal / self._highest if self._highest else 0.0
        low, high = self._limits(place)
        self.mapper.update(palette=palette(place.colours or shown.colour_map), low=low, high=high)
        self.layout.title.text = (
            f"elevation z, coloured by {shown.label}, t = {record.time[place.step]:.3f} s"
        )
        raised = f"height × {number(lift, 2)}; " if lift < _MOST_LIFT else ""  # else it is flat
        self.note.text = f"{raised}drag to turn" if lift else "nothing measured here"
        self.sources["field"].data = {
            "x": [np.asarray(x - x.mean(), np.float32)],
            "y": [np.asarray(y - y.mean(), np.float32)],
            "height": [np.ascontiguousarray(z * np.float32(lift))],
            "value": [np.ascontiguousarray(values * np.float32(shown.factor), np.float32)],
        }
