"""Links to files of what is shown: picture, movie, selection, the view itself."""

from bokeh.layouts import column
from bokeh.models import Spinner
from jinja2 import Environment

from wavefield.explorer.place import MAX_MOVIE_FRAMES, Place
from wavefield.explorer.plot_parts import words_of

_TABLE = Environment(autoescape=True).from_string(
    """<table>{% for title, links in rows %}<tr><td style="padding: 3px 12px 3px 0">{{ title }}</td><td>
{%- for words, href in links %} <a style="padding: 0 6px" href="{{ href }}"
{%- if words != "link" %} download{% endif %}>{{ words }}</a>{% endfor %}</td></tr>{% endfor %}</table>"""
)


class SavePanel:
    """Links that the server answers with files made from the cube."""

    def __init__(self) -> None:
        self.frames = Spinner(
            title="Steps of the movie, from here",
            low=2,
            high=MAX_MOVIE_FRAMES,
            value=100,
            step=10,
            name="frames",
        )
        self.words = words_of("save_words", html=True)
        self.layout = column(self.words, self.frames, sizing_mode="stretch_width")
        self._place = Place()
        self.frames.on_change("value", lambda attr, old, new: self.show(self._place))

    def show(self, place: Place) -> None:
        """List what can be saved of a place."""
        self._place = place
        query = place.query()
        movie = f"{query}&frames={int(self.frames.value or 100)}"
        rows = [
            ("This map", [("PNG", f"save/map.png?{query}"), ("SVG", f"save/map.svg?{query}")]),
            ("Playback from here", [("MP4", f"save/play.mp4?{movie}"), ("GIF", f"save/play.gif?{movie}")]),
            ("This step, all variables", [("NetCDF", f"save/step.nc?{query}")]),
        ]
        if place.node:
            links = [("CSV", f"save/node.csv?{query}"), ("NetCDF", f"save/node.nc?{query}")]
            rows.append(("Series at the node", links))
        if place.line:
            rows.append(("Along the line, now", [("CSV", f"save/line.csv?{query}")]))
        if place.area:
            rows.append(("The rectangle, all steps, thinned", [("NetCDF", f"save/area.nc?{query}")]))
        rows.append(("This view", [("link", f"?{query}")]))
        self.words.text = _TABLE.render(rows=rows)
