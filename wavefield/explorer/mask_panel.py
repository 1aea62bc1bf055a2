"""Masks drawn with the mouse: corners on the map or in a camera's image, saved into the experiment file."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from bokeh.layouts import column, row
from bokeh.models import Button, Div
from numpy.typing import NDArray

from wavefield.errors import WavefieldError
from wavefield.explorer.context import CubeContext
from wavefield.series.masks import WATER

Point = tuple[float, float]
_HOW = (
    "Choose <b>mask</b> under <i>Dragging</i> (key M), then click corner after corner on the map (the water) "
    "or in a camera's image. What lies inside will not be measured."
)


def outlines_of(covered: NDArray[np.bool_]) -> list[NDArray[np.int32]]:
    """Outlines of what is covered in an image.

    With covered (row, column); returns (n, 2): Columns and rows, px.
    """
    found, _ = cv2.findContours(covered.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return [np.asarray(one[:, 0], np.int32) for one in found if len(one) > 2]


class MaskPanel:
    """Corners that were clicked, by camera or on the water."""

    def __init__(self, beside: CubeContext, drawn: Callable[[], None]) -> None:
        self._beside, self._drawn = beside, drawn
        self.corners: dict[str, list[Point]] = {}
        self._order: list[str] = []
        self.words = Div(text=_HOW, name="mask_words", sizing_mode="stretch_width")
        self.undo = Button(label="Take back a corner", name="mask_undo", disabled=True)
        self.clear = Button(label="Clear", name="mask_clear", disabled=True)
        self.save = Button(label="Save", name="mask_save", button_type="primary", disabled=True)
        self.undo.on_click(self._take_back)
        self.clear.on_click(self._forget)
        self.save.on_click(self._save)
        buttons = row(self.undo, self.clear, self.save, styles={"flex-wrap": "wrap"})
        self.layout = column(self.words, buttons, sizing_mode="stretch_width")

    def add(self, where: str, corner: Point) -> None:
        """Add a corner.

        With corner (float, float), px.
        """
        self.corners.setdefault(where, []).append(corner)
        self._order.append(where)
        self._changed()

    def _take_back(self) -> None:
        if self._order:
            self.corners[self._order.pop()].pop()
            self._changed()

    def _forget(self) -> None:
        self.corners, self._order = {}, []
        self._changed()

    def _changed(self) -> None:
        whole = {name: c for name, c in self.corners.items() if c}
        words = "; ".join(
            f"{'the water' if name == WATER else name}: {len(c)} corner{'s' if len(c) > 1 else ''}"
            for name, c in whole.items()
        )
        self.words.text = f"{words}. The last corner joins the first." if words else _HOW
        self.undo.disabled = self.clear.disabled = not whole
        self.save.disabled = not whole or any(len(c) < 3 for c in whole.values())
        self._drawn()

    def _save(self) -> None:
        from wavefield.series.mask_file import add_polygons

        experiment = self._beside.experiment
        if experiment is None:
            self.words.text = "There is no experiment file beside this cube to save masks in."
            return
        try:
            add_polygons(experiment, {name: c for name, c in self.corners.items() if c})
            folder = experiment.image_folder if experiment.folder else None
            self._beside.take(type(experiment).load(experiment.path, folder))
        except WavefieldError as error:
            self.words.text = f'<span role="alert">{_plain(str(error))}</span>'
            return
        self._forget()
        self.words.text = (
            f"Saved in {_plain(experiment.path.name)}. This cube was measured without it: "
            f"<code>wavefield run {_plain(experiment.path.name)} -o masked.zarr</code> measures again."
        )

    def closed(self, where: str) -> tuple[list[float], list[float]]:
        """Corners as a closed line."""
        corners = self.corners.get(where, [])
        line: list[Any] = [*corners, *corners[:1]]
        return [float(p[0]) for p in line], [float(p[1]) for p in line]


def _plain(words: str) -> str:
    return words.replace("&", "&amp;").replace("<", "&lt;")
