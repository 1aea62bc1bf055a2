"""A camera's frame with the nodes where that camera sees them, their displacements and what was rejected."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from bokeh.events import DoubleTap, Tap
from bokeh.layouts import column, row
from bokeh.models import ColumnDataSource, Div, LinearColorMapper, Range1d, Select
from numpy.typing import NDArray

from wavefield.explorer.context import CubeContext
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.mask_panel import outlines_of
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import INK, VERMILION, draw_masks, make_figure
from wavefield.explorer.selections import nearest
from wavefield.figures.quality import KINDS, quality_kind
from wavefield.rig import Camera

_MOST_PIXELS = 1100  # along the longer side: more is not seen
_NODES = 34  # drawn along the longer side of the grid
FRAMES = ("first frame", "second frame")  # of a step
_TARGET = "target: "  # before the name of a pose
_LONGER = 5.0  # displacements are drawn so many times as long


def shrink(image: NDArray[Any]) -> tuple[NDArray[np.uint8], int]:
    """A frame for the screen: whole squares of pixels averaged, grey levels stretched.

    With image (row, column); returns image (row // factor, column // factor): From its 0.5 % to its 99.5 %
    brightness.
    """
    factor = max(1, -(-max(image.shape) // _MOST_PIXELS))
    h, w = (n - n % factor for n in image.shape)
    small = np.asarray(image[:h, :w], np.float32)
    if factor > 1:
        small = cv2.resize(small, (w // factor, h // factor), interpolation=cv2.INTER_AREA).astype(np.float32)
    low, high = np.percentile(small[::4, ::4], [0.5, 99.5])
    return np.clip((small - low) * (255.0 / max(high - low, 1e-6)), 0, 255).astype(np.uint8), factor


def seen_nodes(
    camera: Camera, x: NDArray[Any], y: NDArray[Any], fields: dict[str, NDArray[Any]], dt: float, second: bool
) -> dict[str, NDArray[Any]]:
    """Where a camera sees the nodes in a frame of a step, and where they come from or go to."""
    z = np.where(np.isfinite(fields["z"]), fields["z"], 0.0)
    half = {n: np.where(np.isfinite(fields[n]), 0.5 * dt * fields[n], 0.0) for n in ("u", "v", "w")}
    ends = [camera.project(x + s * half["u"], y + s * half["v"], z + s * half["w"]) for s in (-1.0, 1.0)]
    X, Y = ends[1 if second else 0]
    width, height = camera.size
    there = (X >= 0) & (X <= width - 1) & (Y >= 0) & (Y <= height - 1)
    j, i = np.nonzero(there)
    return {
        "X": X[there],
        "Y": Y[there],
        "dX": (ends[1][0] - ends[0][0])[there],
        "dY": (ends[1][1] - ends[0][1])[there],
        "kind": quality_kind(fields["quality"])[there],
        "j": j,
        "i": i,
    }


class CameraPanel:
    """Frames of the cameras."""

    def __init__(
        self,
        record: CubeRecord,
        beside: CubeContext,
        picked: Callable[[str, tuple[float, ...]], None],
        corner: Callable[[str, tuple[float, float]], bool] = lambda name, where: False,
    ) -> None:
        self._record, self._beside, self._picked, self._corner = record, beside, picked, corner
        cameras = [n for n in beside.frames if beside.rig is None or n in beside.rig.cameras]
        self.camera = Select(
            title="Camera", value=cameras[0] if cameras else "", options=cameras, name="camera"
        )
        self.frame = Select(title="Image", value=FRAMES[0], options=self._images(), name="camera_frame")
        self.drawn = Select(
            title="Over it", value="nodes", options=["nodes", "displacements", "nothing"], name="camera_over"
        )
        self.words = Div(
            text=beside.notes.get("cameras", ""), name="camera_words", sizing_mode="stretch_width"
        )
        self.image = ColumnDataSource(
            {"image": [], "x": [], "y": [], "dw": [], "dh": []}, name="camera_image"
        )
        self.nodes = ColumnDataSource({"X": [], "Y": [], "kind": []}, name="camera_nodes")
        self.moves = ColumnDataSource({"X0": [], "Y0": [], "X1": [], "Y1": []}, name="camera_moves")
        self.grid = ColumnDataSource({"xs": [], "ys": []}, name="camera_grid")
        self.node = ColumnDataSource({"X": [], "Y": []}, name="camera_node")
        self.target = ColumnDataSource({"X": [], "Y": []}, name="camera_target")
        self.mask = ColumnDataSource({"x": [], "y": []}, name="camera_mask")
        self.masks = ColumnDataSource({"xs": [], "ys": []}, name="camera_masks")
        self._seen: dict[str, NDArray[Any]] = {}
        self.figure = self._draw()
        self.layout = column(
            row(self.camera, self.frame, self.drawn, styles={"flex-wrap": "wrap"}),
            self.figure,
            self.words,
            sizing_mode="stretch_width",
        )

    def _draw(self) -> Any:
        shape = next((series.shape for series in self._beside.frames.values()), (3, 4))
        made = make_figure(
            "camera_view",
            tools="pan,wheel_zoom,box_zoom,reset,save",
            toolbar_location="above",
            x_range=Range1d(0, 1),
            y_range=Range1d(1, 0),
            x_axis_label="column (px)",
            y_axis_label="row (px)",
            aspect_ratio=float(np.clip(shape[1] / shape[0], 1.15, 2.2)),
        )
        made.grid.grid_line_color = None
        grey = LinearColorMapper(palette="Greys256", low=255, high=0)
        grey.update(palette=[f"#{k:02x}{k:02x}{k:02x}" for k in range(256)], low=0, high=255)
        made.image("image", source=self.image, color_mapper=grey)
        made.multi_line("xs", "ys", source=self.grid, color="#56B4E9", line_alpha=0.85, line_width=1.2)
        kinds = LinearColorMapper(palette=[k[2] for k in KINDS], low=-0.5, high=len(KINDS) - 0.5)
        made.scatter(
            "X", "Y", source=self.nodes, size=4.5,
            fill_color={"field": "kind", "transform": kinds}, line_color="white", line_width=0.4,
        )  # fmt: skip
        made.segment("X0", "Y0", "X1", "Y1", source=self.moves, color="#F0E442", line_width=1.6)
        made.scatter(
            "X", "Y", source=self.target, marker="cross", size=9, line_color="#56B4E9", line_width=1.8
        )
        made.scatter("X", "Y", source=self.node, size=15, fill_color=None, line_color="white", line_width=5)
        made.scatter(
            "X", "Y", source=self.node, size=15, fill_color=None, line_color=VERMILION, line_width=2.4
        )
        draw_masks(made, self.mask, self.masks)
        for tap in (Tap, DoubleTap):  # a second click within .3 s is no tap, wherever it is
            made.on_event(tap, self._tapped)
        made.title.text_color = INK
        return made

    def show(self, place: Place) -> None:
        """Show a camera's frame of a step."""
        name = self.camera.value
        if not name:
            return
        self.frame.options = self._images()
        if self.frame.value not in self.frame.options:
            self.frame.value = FRAMES[0]
        if self.frame.value.startswith(_TARGET):
            self._show_target(name, self.frame.value.removeprefix(_TARGET))
            return
        self.target.data = {"X": [], "Y": []}
        second = self.frame.value == FRAMES[1]
        frame = self._beside.frames[name].read(place.step + int(second))
        number = self._beside.frames[name].first + place.step + int(second)
        self.figure.title.text = f"{name}, frame {number}"
        self._show_image(frame.image, self._beside.frames[name].shape, frame.message)
        self._show_masks(place.step + int(second))
        self._show_nodes(place, second)

    def _images(self) -> list[str]:
        targets = self._beside.targets
        poses = targets.poses(self.camera.value) if targets is not None else []
        return [*FRAMES, *(f"{_TARGET}{pose}" for pose in poses)]

    def _show_image(self, image: NDArray[Any] | None, shape: tuple[int, ...], message: str) -> None:
        height, width = shape
        if self.figure.x_range.end != width:
            self.figure.x_range.update(start=0, end=width, reset_start=0, reset_end=width)
            self.figure.y_range.update(start=height, end=0, reset_start=height, reset_end=0)
        if image is None:
            self.words.text = f"{message}; the other images can be looked at."
            self.image.data = {key: [] for key in self.image.data}
            return
        small, factor = shrink(image)
        h, w = small.shape
        self.words.text = f"Every pixel here is {factor} x {factor} of the camera's." if factor > 1 else ""
        # bokeh draws row 0 at y, and the axis runs downwards: a positive dh is right as it is
        self.image.data = {"image": [small], "x": [-0.5], "y": [-0.5], "dw": [w * factor], "dh": [h * factor]}

    def _show_target(self, name: str, pose: str) -> None:
        """The target in a pose, with the nodes that are found."""
        assert self._beside.targets is not None
        found = self._beside.targets.found(name, pose)
        self.figure.title.text = f"{name}, target: {pose}"
        shape = self._beside.frames[name].shape if found.image is None else found.image.shape
        self._show_image(found.image, shape, found.words)
        if found.image is not None:
            self.words.text = f"{found.words}. {self.words.text}"
        self.target.data = {"X": found.pixel[:, 0], "Y": found.pixel[:, 1]}
        for source in (self.nodes, self.moves, self.grid, self.node, self.masks):
            source.data = {key: [] for key in source.data}
        self._seen = {}

    def _show_masks(self, frame: int) -> None:
        series = self._beside.frames[self.camera.value]
        covered = series.covered(frame) if frame < len(series) else None
        lines = [] if covered is None else outlines_of(covered)
        self.masks.data = {"xs": [line[:, 0] for line in lines], "ys": [line[:, 1] for line in lines]}

    def _show_nodes(self, place: Place, second: bool) -> None:
        record, rig, name = self._record, self._beside.rig, self.camera.value
        if rig is None or name not in rig.cameras:
            return
        fields = {n: record.field(n, place.step) for n in ("z", "u", "v", "w", "quality")}
        x, y = np.meshgrid(record.x, record.y)
        every = max(1, -(-max(x.shape) // _NODES))
        rows = slice(every // 2, None, every)
        thin = {n: f[rows, rows] for n, f in fields.items()}
        seen = seen_nodes(rig[name], x[rows, rows], y[rows, rows], thin, 1.0 / record.frame_rate, second)
        self._seen = seen | {
            "x": x[rows, rows][seen["j"], seen["i"]],
            "y": y[rows, rows][seen["j"], seen["i"]],
        }
        over = self.drawn.value
        known = seen["kind"] < len(KINDS)
        picked = known if over == "nodes" else known & False
        self.nodes.data = {n: seen[n][picked].astype(np.float32) for n in ("X", "Y", "kind")}
        moving = known & (over == "displacements")
        X, Y = seen["X"][moving], seen["Y"][moving]
        moved = X + _LONGER * seen["dX"][moving], Y + _LONGER * seen["dY"][moving]
        self.moves.data = {"X0": X, "Y0": Y, "X1": moved[0], "Y1": moved[1]}
        if over == "displacements":
            self.words.text += f" Displacements over the step, drawn {_LONGER:g} times as long."
        self._show_grid(rig[name], fields["z"], over != "nothing")
        self._mark(place, rig[name], fields)

    def _show_grid(self, camera: Camera, z: NDArray[Any], requested: bool) -> None:
        """Grid lines on the water as it stands."""
        xs, ys = [], []
        record = self._record
        z = np.where(np.isfinite(z), z, 0.0)
        for j in np.unique(np.linspace(0, record.y.size - 1, 9).astype(int)) if requested else ():
            X, Y = camera.project(record.x, np.full(record.x.size, record.y[j]), z[j])
            xs.append(X)
            ys.append(Y)
        for i in np.unique(np.linspace(0, record.x.size - 1, 9).astype(int)) if requested else ():
            X, Y = camera.project(np.full(record.y.size, record.x[i]), record.y, z[:, i])
            xs.append(X)
            ys.append(Y)
        self.grid.data = {"xs": xs, "ys": ys}

    def _mark(self, place: Place, camera: Camera, fields: dict[str, NDArray[Any]]) -> None:
        self.node.data = {"X": [], "Y": []}
        if place.node is None:
            return
        record = self._record
        j, i = nearest(record.y, place.node[1]), nearest(record.x, place.node[0])
        z = float(fields["z"][j, i])
        X, Y = camera.project(record.x[i], record.y[j], z if np.isfinite(z) else 0.0)
        self.node.data = {"X": [float(X)], "Y": [float(Y)]}

    def _tapped(self, event: Any) -> None:
        rig, name = self._beside.rig, self.camera.value
        if name and self._corner(name, (float(event.x), float(event.y))):
            return
        if rig is None or not name or name not in rig.cameras or not self._seen:
            return
        if not self._seen["X"].size:
            return
        # the level of the nearest node drawn is near enough to go back from pixels to metres
        k = int(np.argmin(np.hypot(self._seen["X"] - event.x, self._seen["Y"] - event.y)))
        self._picked("node", (float(self._seen["x"][k]), float(self._seen["y"][k])))
