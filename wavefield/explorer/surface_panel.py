"""The surface in three dimensions, turned with the mouse: projected in the browser, no round trip."""

from importlib.resources import files
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, CustomJS, Label, LinearColorMapper
from numpy.typing import NDArray

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import colour_map, palette, relief, shown_as
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import INK, colour_bar, make_figure, number
from wavefield.figures.style import limit

TURN, TILT = -0.7, 0.62  # radians, to begin with
_LIFT = 0.1  # the highest water stands so many diagonals above rest


def project(
    x: NDArray[Any], y: NDArray[Any], height: NDArray[Any], turn: float, tilt: float
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Parallel projection of points onto the screen.

    With x, y, height, metres; turn, rad; tilt, rad.
    """
    across = np.cos(turn) * x - np.sin(turn) * y
    away = np.sin(turn) * x + np.cos(turn) * y
    return across, away * np.sin(tilt) + height * np.cos(tilt), away


class SurfacePanel:
    """The relief of z, coloured by the shown variable."""

    def __init__(self, record: CubeRecord) -> None:
        self._record = record
        self._half = 0.0
        self.field = ColumnDataSource({"x": [], "y": [], "height": [], "value": []}, name="surface_field")
        self.quads = ColumnDataSource({"xs": [], "ys": [], "value": []}, name="surface_quads")
        self.frame = ColumnDataSource({"x": [], "y": []}, name="surface_frame")
        self.words = ColumnDataSource({"x": [], "y": [], "text": []}, name="surface_words")
        self.view = ColumnDataSource({"turn": [TURN], "tilt": [TILT]}, name="surface_view")
        self.mapper = LinearColorMapper(palette=palette(colour_map("w")), low=-1, high=1, nan_color="#d9d9d9")
        size = 0.56 * float(np.hypot(np.ptp(record.x), np.ptp(record.y)))
        made = make_figure(
            "surface",
            tools="wheel_zoom,reset,save",
            toolbar_location="above",
            x_range=(-size, size),
            y_range=(-0.72 * size, 0.72 * size),
            aspect_ratio=1.4,
            x_axis_type=None,
            y_axis_type=None,
            min_border_left=4,
        )
        made.grid.grid_line_color = None
        made.line("x", "y", source=self.frame, color="#8b949e", line_dash=[5, 4], line_width=1.3)
        colour = {"field": "value", "transform": self.mapper}
        made.patches("xs", "ys", source=self.quads, fill_color=colour, line_color=colour, line_width=0.6)
        made.text(
            "x", "y", "text", source=self.words, text_align="center", text_baseline="middle", text_color=INK
        )
        self.bar = colour_bar(self.mapper)
        made.add_layout(self.bar, "right")
        self.note = Label(x=8, y=8, x_units="screen", y_units="screen", text="", text_font_size="12px")
        made.add_layout(self.note)
        code = files("wavefield.explorer").joinpath("assets/relief.js").read_text()
        arguments: dict[str, Any] = {"field": self.field, "quads": self.quads, "frame": self.frame}
        turn = CustomJS(args=arguments | {"words": self.words, "view": self.view}, code=code)
        self.field.js_on_change("data", turn)
        self.view.js_on_change("data", turn)
        for event in ("panstart", "pan"):
            made.js_on_event(event, turn)
        self.figure = self.layout = made

    def show(self, place: Place, limits: tuple[float, float]) -> None:
        """Draw a step.

        With limits (float, float).
        """
        record = self._record
        shown = shown_as(place.show, record.units(place.show))
        z, x, y = relief(record.field("z", place.step), record.x, record.y)
        name = "w" if place.show == "quality" else place.show
        values, _, _ = relief(record.field(name, place.step) * np.float32(shown.factor), record.x, record.y)
        if not self._half and np.isfinite(z).any():
            self._half = limit(z)
        diagonal = float(np.hypot(np.ptp(record.x), np.ptp(record.y)))
        lift = _LIFT * diagonal / self._half if self._half else 0.0
        self.mapper.update(palette=palette(colour_map(name)), low=limits[0], high=limits[1])
        self.figure.title.text = (
            f"elevation z, coloured by {name}{shown.suffix}, t = {record.time[place.step]:.3f} s"
        )
        self.note.text = f"height \u00d7 {number(lift, 2)}; drag to turn" if lift else "nothing measured here"
        self.field.data = {
            "x": [np.asarray(x - x.mean(), np.float32)],
            "y": [np.asarray(y - y.mean(), np.float32)],
            "height": [np.ascontiguousarray(z * np.float32(lift))],
            "value": [np.ascontiguousarray(values, np.float32)],
        }
