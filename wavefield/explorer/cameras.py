"""Panels of a page: a camera's images with the nodes of the grid, and masks whose corners the user clicks."""

import json
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from bokeh.events import Tap
from bokeh.layouts import column, row
from bokeh.models import Button, ColumnDataSource, CustomJS, Range1d, Select
from bokeh.plotting import figure
from numpy.typing import NDArray

from wavefield.explorer import parts
from wavefield.explorer.parts import Place, plain, text_line
from wavefield.explorer.record import LookSession, nearest
from wavefield.figures.display import KINDS, quality_kind, thin
from wavefield.rig import Camera
from wavefield.series.masks import WATER

Corner = tuple[float, float]
_HOW = (
    "Choose <b>mask</b> under <i>Clicks</i> (key M), then click corner after corner on the map (the "
    "water) or in a camera's image. Three corners make a mask."
)


def mask_outlines(covered: NDArray[np.bool_]) -> list[NDArray[np.int32]]:
    """Return the outer outline of each connected True region of a Boolean image (row, column).
    Each is an array (n, 2) of column and row, px; regions with fewer than three corners are left out."""
    found, _ = cv2.findContours(covered.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return [np.asarray(outline[:, 0], np.int32) for outline in found if len(outline) > 2]


class MaskPanel:
    """The tab where the user makes masks: polygons, drawn by clicks, that exclude water or parts of images.
    It shows the lines to add to the experiment file. Every change of the corners calls `changed`."""

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._corners: list[tuple[str, Corner]] = []  # camera or WATER, corner; in the order of the clicks
        self.words = text_line("mask_words", _HOW, html=True)
        self.undo = Button(label="Remove the last corner", name="mask_undo", disabled=True)
        self.clear = Button(label="Clear", name="mask_clear", disabled=True)
        self.undo.on_click(lambda: self._keep(self._corners[:-1]))
        self.clear.on_click(lambda: self._keep([]))
        buttons = row(self.undo, self.clear, styles={"flex-wrap": "wrap"})
        self.layout = column(self.words, buttons, sizing_mode="stretch_width")

    def add(self, image: str, corner: Corner) -> None:
        """Add a corner to the mask of `image`, which is the name of a camera or `WATER` (the water surface).
        A corner is (column, row), px, for a camera, and (x, y), metres, for the water."""
        if np.isfinite(corner).all():
            self._keep([*self._corners, (image, corner)])

    def closed_line(self, image: str) -> dict[str, list[float]]:
        """Return the corners of the mask in `image`, a camera or `WATER`, as lists "x" and "y".
        The first corner is repeated at the end, which closes the polygon."""
        corners = [corner for name, corner in self._corners if name == image]
        line = [*corners, *corners[:1]]
        return {"x": [float(x) for x, _ in line], "y": [float(y) for _, y in line]}

    def _keep(self, corners: list[tuple[str, Corner]]) -> None:
        self._corners = corners
        self.undo.disabled = self.clear.disabled = not corners
        polygons: dict[str, list[Corner]] = {}
        for name, corner in corners:
            polygons.setdefault(name, []).append(corner)
        complete = {name: polygon for name, polygon in polygons.items() if len(polygon) >= 3}
        lines = f"Add to the experiment file:<pre>{plain(mask_lines(complete))}</pre>"
        self.words.text = lines if complete else _HOW
        self._changed()


def mask_lines(polygons: dict[str, list[Corner]]) -> str:
    """Return the entry `mask` of an experiment file, as YAML text.
    `polygons` maps each camera to mask corners (column, row), px, and `WATER` to corners (x, y), metres."""
    lines = ["mask:"]
    for name, corners in polygons.items():
        digits = 4 if name == WATER else 1  # 0.1 mm, 0.1 px
        rounded = [[round(x, digits), round(y, digits)] for x, y in corners]
        lines.append(f"  {json.dumps(name)}: [{{polygon: {rounded}}}]")
    return "\n".join(lines)


MAX_SCREEN_PX = 1000  # along the longer side of an image, which is sent to the browser for every step
_MOTION = ("u", "v", "w")
Fields = dict[str, NDArray[np.floating]]
Image = NDArray[Any]


def shrink(image: Image) -> tuple[NDArray[np.uint8], int]:
    """Return an 8-bit copy of an image (row, column) with at most 1000 px along each side, and a factor n.
    Each pixel of the copy is the mean of n x n pixels. Grey levels are scaled: their 0.5 % and 99.5 %
    quantiles become 0 and 255."""
    factor = max(1, -(-max(image.shape) // MAX_SCREEN_PX))
    h, w = (n - n % factor for n in image.shape)
    small = np.asarray(image[:h, :w], np.float32)
    if factor > 1:
        small = cv2.resize(small, (w // factor, h // factor), interpolation=cv2.INTER_AREA).astype(np.float32)
    low, high = np.percentile(small[::4, ::4], [0.5, 99.5])
    return np.clip((small - low) * (255.0 / max(high - low, 1e-6)), 0, 255).astype(np.uint8), factor


def keep_pixels_square(made: figure) -> None:
    """Make the browser adjust the axis ranges of a figure to its size, so that image pixels are square."""
    square = CustomJS(args={"made": made}, code=parts.asset("square.js"))
    for changed in ("inner_width", "inner_height", "tags"):
        made.js_on_change(changed, square)


def fit_image(made: figure, shape: tuple[int, ...]) -> None:
    """Set the axis ranges of a figure to an image of `shape` (rows, columns).
    If the last image had the same shape, leave them, since the user may have zoomed."""
    height, width = shape
    if made.tags != [width, height]:  # else the user may have zoomed
        made.x_range.update(start=0, end=width, reset_start=0, reset_end=width)
        made.y_range.update(start=height, end=0, reset_start=height, reset_end=0)
        made.tags = [width, height]


def show_frame(made: figure, source: ColumnDataSource, image: Image) -> int:
    """Show a camera image (row, column) on the figure `made`, with axes in px, through the figure's `source`.
    Return n: each displayed pixel is the mean of n x n pixels of the image."""
    fit_image(made, image.shape)
    small, factor = shrink(image)
    h, w = small.shape
    # Bokeh draws row 0 at y, and the axis points downwards: dh is positive
    source.data = {"image": [small], "x": [-0.5], "y": [-0.5], "dw": [w * factor], "dh": [h * factor]}
    return factor


def visible_nodes(
    camera: Camera, x: NDArray[np.floating], y: NDArray[np.floating], fields: Fields, dt: float
) -> Fields:
    """Return the n grid nodes that a camera sees in the first of the two frames of a step, as arrays (n,).
    Nodes x, y (m) and `fields` z (m), u, v, w (m/s) and quality, midway in time, have the shape (ny, nx);
    `dt` is the time between frames, s. Returned by name: x, y; X, Y, the column and row of the water in the
    first frame, px; and kind, an index of the quality (see `quality_kind`)."""
    z = np.where(np.isfinite(fields["z"]), fields["z"], 0.0)
    half = [np.where(np.isfinite(fields[n]), 0.5 * dt * fields[n], 0.0) for n in _MOTION]
    X, Y = camera.project(*(p - h for p, h in zip((x, y, z), half)))
    width, height = camera.size
    visible = (X >= 0) & (X <= width - 1) & (Y >= 0) & (Y <= height - 1)
    found = {"x": x, "y": y, "X": X, "Y": Y}
    found["kind"] = quality_kind(fields["quality"].astype(int)).astype(np.float32)
    return {name: values[visible] for name, values in found.items()}


class CameraPanel:
    """The tab with the image of one camera and the grid nodes drawn on it.
    A click calls `took_corner(camera, column, row)`, which may use it as a corner of a mask. If that returns
    False, `picked` is called with x, y of the nearest node, m. A new camera or overlay calls `changed`."""

    def __init__(
        self,
        session: LookSession,
        picked: Callable[[float, float], None],
        took_corner: Callable[[str, float, float], bool],
        changed: Callable[[], None],
    ) -> None:
        self._session, self._picked, self._took_corner = session, picked, took_corner
        run = session.run
        self._nodes: Fields = {}  # result of `visible_nodes` for the displayed frame
        cameras = [name for name in run.frames if run.rig is None or name in run.rig.cameras]
        self.camera = Select(
            title="Camera", value=cameras[0] if cameras else "", options=cameras, name="camera"
        )
        self.overlay = Select(
            title="Overlay", value="nodes", options=["nodes", "nothing"], name="camera_over"
        )
        for widget in (self.camera, self.overlay):
            widget.on_change("value", lambda attr, old, new: changed())
        absent = "" if cameras else run.reason("frames")
        self.words = text_line("camera_words", f"no images: {absent}" if absent else "")
        self.sources = parts.make_sources(
            "camera", image=parts.IMAGE, nodes="X Y kind", grid="xs ys", node="X Y",
            mask="x y", masks="xs ys",
        )  # fmt: skip
        self.figure = self._draw()
        self.layout = column(
            row(self.camera, self.overlay, styles={"flex-wrap": "wrap"}),
            self.figure, self.words, sizing_mode="stretch_width",
        )  # fmt: skip

    def _draw(self) -> figure:
        height, width = next((one.shape for one in self._session.run.frames.values()), (3, 4))
        made = parts.make_figure(
            "camera_view", tools="pan,wheel_zoom,box_zoom,reset,save", toolbar_location="above",
            x_range=Range1d(0, 1), y_range=Range1d(1, 0), x_axis_label="column (px)", y_axis_label="row (px)",
            aspect_ratio=float(np.clip(width / height, 1.15, 2.2)), sizing_mode="scale_width",
        )  # fmt: skip
        made.grid.grid_line_color = None
        keep_pixels_square(made)
        source = self.sources
        made.image("image", source=source["image"], color_mapper=parts.grey_mapper())
        made.multi_line("xs", "ys", source=source["grid"], color=parts.SKY, line_alpha=0.85, line_width=1.2)
        made.scatter(
            "X", "Y", source=source["nodes"], size=4.5, line_color="white", line_width=0.4,
            fill_color={"field": "kind", "transform": parts.quality_mapper()},
        )  # fmt: skip
        parts.draw_ring(made, source["node"], "X", "Y", parts.VERMILION, 15)
        parts.draw_masks(made, source["mask"], source["masks"])
        parts.on_click(made, self._clicked)
        return made

    # -- showing ---------------------------------------------------------------------------------------

    def show(self, place: Place) -> None:
        """Show the first frame of the step `place.step` of the chosen camera, with its masks and nodes."""
        name = parts.chosen(self.camera)
        if not name:
            return
        series, index = self._session.run.frames[name], place.step
        frame = series.read(index)
        self.figure.title.text = f"{name}, frame {series.first + index}"
        if frame.image is None:
            self.words.text = f"{frame.message}; other images can be shown."
            fit_image(self.figure, series.shape)
            parts.clear(self.sources["image"])
        else:
            factor = show_frame(self.figure, self.sources["image"], frame.image)
            averaged = f"Each pixel is the mean of {factor} x {factor} pixels of the camera."
            self.words.text = averaged if factor > 1 else ""
        covered = series.covered(index) if index < len(series) else None
        lines = [] if covered is None else mask_outlines(covered)
        xs, ys = ([line[:, k] for line in lines] for k in (0, 1))
        self.sources["masks"].data = {"xs": xs, "ys": ys}
        rig = self._session.run.rig
        if rig is not None and name in rig.cameras:
            self._show_nodes(rig[name], place)

    def _show_nodes(self, camera: Camera, place: Place) -> None:
        record, drawing = self._session.record, parts.chosen(self.overlay) == "nodes"
        fields = {name: record.field(name, place.step) for name in ("z", *_MOTION, "quality")}
        x, y = np.meshgrid(record.x, record.y)
        all_, some = slice(None), (thin(*x.shape),) * 2
        self._nodes = visible_nodes(
            camera, x[some], y[some], {name: field[some] for name, field in fields.items()},
            1.0 / record.frame_rate,
        )  # fmt: skip
        of_a_kind = self._nodes["kind"] < len(KINDS)
        drawn = {key: values[of_a_kind].astype(np.float32) for key, values in self._nodes.items()}
        self.sources["nodes"].data = {key: drawn[key] if drawing else [] for key in ("X", "Y", "kind")}
        z = np.where(np.isfinite(fields["z"]), fields["z"], 0.0)
        sides = ((0, all_), (-1, all_), (all_, 0), (all_, -1))  # the outline of the grid on the water
        lines = [camera.project(x[side], y[side], z[side]) for side in sides if drawing]
        self.sources["grid"].data = {"xs": [X for X, _ in lines], "ys": [Y for _, Y in lines]}
        parts.clear(self.sources["node"])
        if place.node is not None:
            j, i = nearest(record.y, place.node[1]), nearest(record.x, place.node[0])
            column_px, row_px = camera.project(record.x[i], record.y[j], z[j, i])
            self.sources["node"].data = {"X": [float(column_px)], "Y": [float(row_px)]}

    def _clicked(self, event: Tap) -> None:
        name = parts.chosen(self.camera)
        if name and self._took_corner(name, float(event.x), float(event.y)):
            return
        nodes = self._nodes
        if nodes and nodes["X"].size:  # pick the drawn node nearest to the click
            k = int(np.argmin(np.hypot(nodes["X"] - event.x, nodes["Y"] - event.y)))
            self._picked(float(nodes["x"][k]), float(nodes["y"][k]))
