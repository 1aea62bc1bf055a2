"""Links to what is seen: picture, movie, selection, the view itself."""

from bokeh.layouts import column
from bokeh.models import Div, Spinner

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.place import Place


class SavePanel:
    """Links that the server answers with files made from the cube."""

    def __init__(self) -> None:
        self.frames = Spinner(
            title="Steps of the movie, from here", low=2, high=2000, value=100, step=10, name="frames"
        )
        self.words = Div(text="", name="save_words", sizing_mode="stretch_width")
        self.layout = column(self.words, self.frames, sizing_mode="stretch_width")
        self._last: tuple[Place, CubeRecord] | None = None
        self.frames.on_change("value", lambda attr, old, new: self._last and self.show(*self._last))

    def show(self, place: Place, record: CubeRecord) -> None:
        """Offer what can be saved of a place."""
        self._last = (place, record)
        query = place.query()
        movie = f"{query}&frames={int(self.frames.value or 100)}"
        rows = [
            ("This map", [("PNG", f"save/map.png?{query}"), ("SVG", f"save/map.svg?{query}")]),
            ("The play from here", [("MP4", f"save/play.mp4?{movie}"), ("GIF", f"save/play.gif?{movie}")]),
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
        self.words.text = "<table>" + "".join(_row(*entry) for entry in rows) + "</table>"


def _row(what: str, links: list[tuple[str, str]]) -> str:
    cells = " ".join(
        f'<a style="padding: 0 6px" href="{href.replace("&", "&amp;")}"{_download(word)}>{word}</a>'
        for word, href in links
    )
    return f'<tr><td style="padding: 3px 12px 3px 0">{what}</td><td>{cells}</td></tr>'


def _download(word: str) -> str:
    return "" if word == "link" else " download"
