"""The page of `wavefield follow`: map, cameras, lights, while the cameras write."""

from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, Div, LinearColorMapper, Select
from bokeh.server.server import BaseServer as Server

from wavefield.explorer.camera_panel import shrink
from wavefield.explorer.context import CubeContext
from wavefield.explorer.follower import FollowedSet, Follower
from wavefield.explorer.lights import StatusLight, verdict
from wavefield.explorer.map_fields import arrows, colour_limits, colour_map, palette, shown_as
from wavefield.explorer.plot_parts import GREY, INK, colour_bar, image_data, image_source, make_figure
from wavefield.explorer.server import make_server
from wavefield.explorer.target_watch import TargetWatch
from wavefield.explorer.template import dress
from wavefield.figures.style import limit
from wavefield.text import spell_time
from wavefield.variables import TABLE

_OFTEN = 200  # ms between looks for something new
_SHOWN = ("z", "w", "u", "v", "z_t", "eps_y", "eps_piv", "z_std")

# sign and word beside each colour: nobody needs to tell the colours apart
_SIGNS = {
    "good": ("\u2714", "#009E73", "good"),
    "doubtful": ("!", "#E69F00", "look at it"),
    "bad": ("\u2716", "#D55E00", "mend it"),
    "unknown": ("?", "#8b949e", "not known"),
}


_LEFT = "style='text-align: left; font-weight: 600; padding-right: 10px'"


def lights_table(lights: tuple[StatusLight, ...]) -> str:
    """Lights as a table: a row per thing judged, a column per camera."""
    frames = [light for light in lights if light.camera and "-" not in light.camera]
    cameras = list(dict.fromkeys(light.camera for light in frames))
    rows = ["<tr><th></th>" + "".join(f"<th>{camera}</th>" for camera in cameras) + "</tr>"]
    for name in dict.fromkeys(light.name for light in frames):
        found = {light.camera: light for light in frames if light.name == name}
        cells = "".join(_cell(found[c], 1) if c in found else "<td></td>" for c in cameras)
        rows.append(f"<tr><th {_LEFT}>{name}</th>{cells}</tr>")
    for light in lights:
        if light not in frames:
            label = f"{light.name} {light.camera}".strip()
            rows.append(f"<tr><th {_LEFT}>{label}</th>{_cell(light, len(cameras) or 1)}</tr>")
    return f"<table>{''.join(rows)}</table>"


def _cell(light: StatusLight, columns: int) -> str:
    sign, colour, word = _SIGNS[light.state]
    return (
        f"<td colspan='{columns}' style='padding: 2px 10px 2px 0'><b style='display: inline-block; "
        f"width: 1.4em; text-align: center; color: white; background: {colour}; border-radius: 4px' "
        f"title='{word}'>{sign}</b> {light.words}</td>"
    )


class FollowPage:
    """One person's page."""

    def __init__(self, follower: Follower, targets: TargetWatch, probes: Any = None) -> None:
        self._follower, self._targets = follower, targets
        self._count = -1
        self._grid: tuple[np.ndarray, np.ndarray] | None = None
        self.state = Div(text="", name="state_words", sizing_mode="stretch_width")
        self.verdict = Div(text="Waiting for frames.", name="verdict", sizing_mode="stretch_width")
        self.lights = Div(text="", name="lights", sizing_mode="stretch_width")
        self.target = Div(text="", name="target_words", sizing_mode="stretch_width")
        self.show = Select(title="Map of", value="w", options=list(_SHOWN), name="show", width=110)
        self.show.on_change("value", lambda attr, old, new: self._again())
        self.mapper = LinearColorMapper(palette=palette(colour_map("w")), nan_color=GREY, low=-1, high=1)
        self.image, self.shafts = (
            image_source("map_image"),
            ColumnDataSource({"x": [], "y": []}, name="map_arrows"),
        )
        self.map = self._draw_map(probes)
        self.cameras = {name: self._draw_camera(name) for name in follower.experiment.cameras}
        self._lights_shown: tuple[StatusLight, ...] = ()

    def _draw_map(self, probes: Any) -> Any:
        made = make_figure(
            "map", tools="pan,wheel_zoom,reset,save", toolbar_location="above", match_aspect=True,
            aspect_ratio=1.3, sizing_mode="scale_width", x_axis_label="x (m)", y_axis_label="y (m)",
        )  # fmt: skip
        made.grid.grid_line_color = None
        shown = made.image("image", source=self.image, color_mapper=self.mapper)
        made.x_range.renderers = made.y_range.renderers = [shown]
        made.line("x", "y", source=self.shafts, color=INK, line_width=1.1)
        if probes is not None:
            places = {"x": probes.probe_x.values, "y": probes.probe_y.values}
            source = ColumnDataSource(places | {"name": [str(n) for n in probes.probe.values]})
            made.scatter(
                "x", "y", source=source, marker="triangle", size=11, fill_color="#F0E442", line_color=INK
            )
            made.text("x", "y", "name", source=source, x_offset=8, text_font_size="11px")
        made.add_layout(colour_bar(self.mapper), "right")
        return made

    def _draw_camera(self, name: str) -> Any:
        made = make_figure(
            f"{name}_view", tools="pan,wheel_zoom,reset", x_range=(0, 100), y_range=(100, 0),
            aspect_ratio=1.25, min_border_left=34, min_width=150, title=name,
        )  # fmt: skip
        made.grid.grid_line_color = None
        grey = LinearColorMapper(palette=[f"#{k:02x}{k:02x}{k:02x}" for k in range(256)], low=0, high=255)
        source = image_source(f"{name}_image")
        made.image("image", source=source, color_mapper=grey)
        nodes = ColumnDataSource({"x": [], "y": []}, name=f"{name}_nodes")
        made.scatter("x", "y", source=nodes, marker="cross", size=8, line_color="#56B4E9", line_width=1.6)
        return made, source, nodes

    def attach(self, document: Any) -> None:
        """Put the page into a document."""
        views = [made for made, _, _ in self.cameras.values()]
        places = (
            (column(self.state, sizing_mode="stretch_width"), "state"),
            (column(self.verdict, sizing_mode="stretch_width"), "controls"),
            (column(self.show, self.map, sizing_mode="stretch_width"), "views"),
            (
                column(
                    self.lights,
                    row(*views, sizing_mode="stretch_width", styles={"flex-wrap": "wrap"}),
                    self.target,
                    sizing_mode="stretch_width",
                ),
                "picked",
            ),
        )  # fmt: skip
        for root, name in places:
            root.name = name
            document.add_root(root)
        dress(document, self._follower.experiment.name, "follow", ("controls", "views", "picked"), keys=False)
        document.add_periodic_callback(self.look, _OFTEN)
        self.look()

    # -- showing ---------------------------------------------------------------------------------------

    def _again(self) -> None:
        self._count = -1
        self.look()

    def look(self) -> None:
        """Show what is new."""
        seen = self._follower.seen
        self._show_target()
        if seen is None:
            self._wait()
            return
        if seen.lights != self._lights_shown:
            self._show_lights(seen)
        if self._follower.count != self._count:
            self._count = self._follower.count
            self._show_set(seen)

    def _wait(self) -> None:
        trouble = list(self._follower.watch.trouble.values())
        self.verdict.text = _large("Waiting for frames", "#57606a", "<br>".join(map(_plain, trouble)))

    def _show_lights(self, seen: FollowedSet) -> None:
        self._lights_shown = seen.lights
        self.lights.text = lights_table(seen.lights)
        first = verdict(seen.lights)
        if first is None:
            doubtful = [f"{one.name} {one.camera}".strip() for one in seen.lights if one.state == "doubtful"]
            words = f"to look at: {', '.join(doubtful)}" if doubtful else "all lights are good"
            colour = "#B07800" if doubtful else "#007a5a"
            self.verdict.text = _large("Sound" if not doubtful else "Sound with remarks", colour, words)
        else:
            self.verdict.text = _large(f"{first.name} {first.camera}".strip(), "#B34700", first.words)

    def _show_set(self, seen: FollowedSet) -> None:
        self.state.text = (
            f"frame {seen.number}; measured {seen.measured}, skipped {seen.skipped}; "
            f"{_spell_delay(seen.delay)} after its last byte"
            + (f". {_plain(seen.trouble)}" if seen.trouble else "")
        )
        for name, image in seen.images.items():
            _show_image(self.cameras[name], image)
        if seen.fields:
            self._show_map(seen)

    def _show_map(self, seen: FollowedSet) -> None:
        x, y = self._follower.nodes
        name = self.show.value
        shown = shown_as(name, TABLE[name].units)
        values = seen.fields[name] * np.float32(shown.factor)
        low, high = colour_limits(values, name)
        half = max(high, self.mapper.high) if self.map.title.text.startswith(f"{name}:") else high
        self.mapper.update(palette=palette(colour_map(name)), low=-half if low < 0 else 0.0, high=half)
        self.image.data = image_data(values, x, y)
        u, v = seen.fields["u"], seen.fields["v"]
        speed = limit(np.hypot(u, v), 98) if np.isfinite(u).any() else 0.0
        xs, ys, _ = arrows(u, v, x, y, speed)
        self.shafts.data = {"x": xs, "y": ys}
        self.map.title.text = f"{name}: {TABLE[name].long_name}{shown.suffix}, frame {seen.number}"

    def _show_target(self) -> None:
        found = self._targets.found
        self.target.text = self._targets.words
        if self._follower.seen is not None:
            return
        for name, (image, points) in found.items():
            if name in self.cameras:
                _show_image(self.cameras[name], image)
                self.cameras[name][2].data = {"x": points[:, 0], "y": points[:, 1]}


def _show_image(view: Any, image: np.ndarray) -> None:
    made, source, nodes = view
    small, factor = shrink(image)
    step = max(1, max(small.shape) // 400)  # three of them beside each other
    small = np.ascontiguousarray(small[::step, ::step])
    h, w = small.shape
    source.data = {
        "image": [small],
        "x": [-0.5],
        "y": [-0.5],
        "dw": [w * factor * step],
        "dh": [h * factor * step],
    }
    if nodes.data["x"] is not None and len(nodes.data["x"]):
        nodes.data = {"x": [], "y": []}
    if made.x_range.end != image.shape[1]:
        made.x_range.update(start=0, end=image.shape[1])
        made.y_range.update(start=image.shape[0], end=0)


def _large(heading: str, colour: str, words: str) -> str:
    return f"<b style='font-size: 19px; color: {colour}'>{_plain(heading)}</b> &nbsp; {words}"


def _plain(words: str) -> str:
    return words.replace("&", "&amp;").replace("<", "&lt;")


def follow_server(follower: Follower, port: int | None = None) -> Server:
    """A server of the page of an experiment that is being recorded."""
    probes = _probes(follower)
    targets = TargetWatch(follower.experiment)
    targets.start()
    return make_server(lambda document: FollowPage(follower, targets, probes).attach(document), port)


def _probes(follower: Follower) -> Any:
    from wavefield.errors import WavefieldError

    beside = CubeContext()
    if follower.experiment.probes:
        try:
            beside.probes = follower.experiment.read_probes()
        except WavefieldError as error:
            beside.notes["probes"] = str(error)
    return beside.probes


def _spell_delay(seconds: float) -> str:
    """To a tenth of a second while cameras write; of frames that lie there for long, as people say it."""
    return f"{seconds:.1f} s" if seconds < 60 else spell_time(seconds)
