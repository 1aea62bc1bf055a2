"""The page of `wavefield follow`: map, images and status lights while the cameras record."""

from contextlib import suppress
from typing import Any

import numpy as np
import xarray as xr
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import LinearColorMapper, Select
from bokeh.plotting import figure
from numpy.typing import NDArray

from wavefield.errors import WavefieldError
from wavefield.explorer import parts
from wavefield.explorer.cameras import keep_pixels_square, show_frame
from wavefield.explorer.lights import StatusLight, red_lights
from wavefield.explorer.live import POLL_S, FollowedSet, Follower
from wavefield.explorer.map import arrows, draw_layers, top_speed
from wavefield.explorer.parts import plain
from wavefield.explorer.server import PageServer, make_server
from wavefield.figures.display import display
from wavefield.text import spell_time

_VARIABLES = ("z", "w", "u", "v", "z_t", "eps_y", "eps_piv", "z_std")


def lights_table(lights: tuple[StatusLight, ...]) -> str:
    """Return status lights as an HTML table with a column per camera.
    The lights of pairs of cameras and of the whole rig are rows below those of single cameras."""
    of_cameras = [light for light in lights if light.camera and "-" not in light.camera]
    cameras = list(dict.fromkeys(light.camera for light in of_cameras))
    cells = {(light.name, light.camera): light for light in of_cameras}
    names = list(dict.fromkeys(light.name for light in of_cameras))
    others = [light for light in lights if light not in of_cameras]
    template = parts.template("lights.html")
    return template.render(cameras=cameras, names=names, cells=cells, others=others)


class CameraView:
    """The figure with the newest image of the camera `name`."""

    def __init__(self, name: str) -> None:
        self.source = parts.make_sources(name, image=parts.IMAGE)["image"]
        self.figure = parts.make_figure(
            f"{name}_view", tools="pan,wheel_zoom,reset", x_range=(0, 100), y_range=(100, 0),
            aspect_ratio=1.25, min_border_left=34, min_width=300, title=name,
        )  # fmt: skip
        self.figure.grid.grid_line_color = None
        keep_pixels_square(self.figure)
        self.figure.image("image", source=self.source, color_mapper=parts.grey_mapper())

    def show(self, image: NDArray[Any]) -> None:
        """Show an image (row, column) of the camera."""
        show_frame(self.figure, self.source, image)


class FollowPage:
    """The web page, in one browser tab, that shows the results of `follower` while cameras record.
    `probes`, wave probes at probe_x and probe_y in metres, are marked on the map."""

    def __init__(self, follower: Follower, probes: xr.Dataset | None = None) -> None:
        self._follower = follower
        self._count = -1  # `Follower.count` when the page was last drawn
        self._shown: tuple[object, ...] = ()  # lights and sentence that were drawn last
        names = {"state": "state_words", "verdict": "verdict", "lights": "lights"}
        self.words = {key: parts.text_line(name, html=True) for key, name in names.items()}
        self.variable = Select(
            title="Map of", value="w", options=parts.named(_VARIABLES), name="show", width=230
        )
        self.variable.on_change("value", lambda attr, old, new: self._redraw())
        self.mapper = LinearColorMapper(
            palette=parts.palette(display("w").colour_map), nan_color=parts.GREY, low=-1, high=1
        )
        self.sources = parts.make_sources(
            "map", image=parts.IMAGE, arrows="x y", probes="x y name align offset"
        )
        if probes is not None:
            names, x, y = probes.probe.values.astype(str), probes.probe_x.values, probes.probe_y.values
            self.sources["probes"].data = parts.probe_columns(names, x, y, float(np.nanmean(x)))
        self.map = self._draw_map()
        self.cameras = {name: CameraView(name) for name in follower.experiment.cameras}

    def _draw_map(self) -> figure:
        made = parts.make_figure(
            "map", tools="pan,wheel_zoom,reset,save", toolbar_location="above", match_aspect=True,
            aspect_ratio=1.3, sizing_mode="scale_width", x_axis_label="x (m)", y_axis_label="y (m)",
        )  # fmt: skip
        made.title.text = "waiting for the first measured step"
        draw_layers(made, self.sources, self.mapper)
        made.add_layout(parts.colour_bar(self.mapper), "right")
        return made

    def attach(self, document: Document) -> None:
        """Add the page to a Bokeh document, which from then on calls `refresh` five times a second."""
        views = [view.figure for view in self.cameras.values()]
        camera_row = row(*views, sizing_mode="stretch_width", styles={"flex-wrap": "wrap"})
        roots = {
            "state": [self.words["state"]],
            "controls": [self.words["verdict"]],
            "views": [self.variable, self.map],
            "picked": [self.words["lights"]],
            "cameras": [camera_row],
        }
        for name, children in roots.items():
            document.add_root(column(*children, sizing_mode="stretch_width", name=name))
        title = self._follower.experiment.name
        parts.apply_template(document, title, "follow", ("controls", "views", "picked", "cameras"))
        document.add_periodic_callback(self.refresh, int(1000 * POLL_S))
        self.refresh()

    # -- showing ---------------------------------------------------------------------------------------

    def _redraw(self) -> None:
        self._count = -1
        self.refresh()

    def refresh(self) -> None:
        """Draw the lights, images and map that the follower has published since the last call."""
        latest = self._follower.latest
        if latest is None:
            trouble = "<br>".join(map(plain, self._follower.watch.trouble.values()))
            self.words["verdict"].text = _large("Waiting for frames", "#57606a", trouble)
            return
        shown = latest.lights, bool(latest.fields), latest.trouble
        if self._shown != shown:
            self._shown = shown
            self._show_lights(latest)
        if self._follower.count != self._count:
            self._count = self._follower.count
            self._show_set(latest)

    def _show_lights(self, latest: FollowedSet) -> None:
        lights = latest.lights
        self.words["lights"].text = lights_table(lights)
        doubtful = [f"{light.name} {light.camera}".strip() for light in lights if light.state == "doubtful"]
        red = red_lights(lights)
        if red:
            cameras: dict[str, list[str]] = {}
            for light in red:
                cameras.setdefault(light.name, []).append(light.camera)
            heading = "; ".join(f"{name} {', '.join(of)}".strip() for name, of in cameras.items())
            colour, words = "#a83d00", "; ".join(dict.fromkeys(light.words for light in red))
        elif not latest.fields:
            heading, colour = "Waiting for the first measured step", "#57606a"
            words = "the lights below rate the images only"
        elif doubtful:
            heading, colour, words = "Sound with remarks", "#7a5200", f"check {', '.join(doubtful)}"
        else:
            heading, colour, words = "Sound", "#007a5a", "all lights are good"
        self.words["verdict"].text = _large(heading, colour, plain(words))

    def _show_set(self, latest: FollowedSet) -> None:
        delay = f"{latest.delay:.1f} s" if latest.delay < 60 else spell_time(latest.delay)
        words = f"frame {latest.number}; "
        if latest.fields:
            words += f"measured {latest.measured}, skipped {latest.skipped}; latency {delay}"
        else:
            words += "nothing measured yet"
        self.words["state"].text = f"{words}; {plain(latest.trouble)}" if latest.trouble else words
        for name, image in latest.images.items():
            self.cameras[name].show(image)
        if latest.fields:
            self._show_map(latest)

    def _show_map(self, latest: FollowedSet) -> None:
        x, y = self._follower.nodes
        shown = display(parts.chosen(self.variable))
        values = latest.fields[shown.name].astype(np.float32) * np.float32(shown.factor)
        low, high = shown.limits(values)
        if self.map.title.text.startswith(f"{shown.name}:"):  # the scale grows only
            high = max(high, self.mapper.high)
        self.mapper.update(palette=parts.palette(shown.colour_map), low=-high if low < 0 else 0.0, high=high)
        self.sources["image"].data = parts.image_data(values, x, y)
        u, v = (np.asarray(latest.fields[name], float) for name in "uv")
        xs, ys, _ = arrows(u, v, x, y, top_speed(u, v))
        self.sources["arrows"].data = {"x": xs, "y": ys}
        self.map.title.text = f"{shown.name}: {shown.long_name}{shown.in_unit}, frame {latest.number}"


def _large(heading: str, colour: str, words: str) -> str:
    """Return HTML: the plain text `heading`, large and in `colour`, followed by `words`, which are HTML."""
    return f"<b style='font-size: 19px; color: {colour}'>{plain(heading)}</b> &nbsp; {words}"


def follow_server(follower: Follower, port: int | None = None) -> PageServer:
    """Return a web server of the page that shows the results of `follower` while cameras record.
    `port` 0 means any free port, None the first free one from 5006 on."""
    probes = None
    with suppress(WavefieldError):  # the page only marks them on the map
        if follower.experiment.probes:
            probes = follower.experiment.read_probes()
    return make_server(lambda document: FollowPage(follower, probes).attach(document), port)
