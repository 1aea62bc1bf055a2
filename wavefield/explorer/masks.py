"""Masks drawn with the mouse: corners on the map or in a camera's image, saved into the experiment file."""

import shlex
from collections.abc import Callable

import cv2
import numpy as np
from bokeh.layouts import column, row
from bokeh.models import Button
from numpy.typing import NDArray

from wavefield.errors import WavefieldError
from wavefield.explorer.parts import alert, plain, words_of
from wavefield.explorer.place import Place
from wavefield.explorer.record import LookSession
from wavefield.series.mask_file import add_polygons
from wavefield.series.masks import WATER

Corner = tuple[float, float]
_HOW = (
    "Choose <b>mask</b> under <i>Clicks</i> (key M), then click corner after corner on the map (the "
    "water) or in a camera's image. What is inside will not be measured."
)


def outlines_of(covered: NDArray[np.bool_]) -> list[NDArray[np.int32]]:
    """Outlines (n, 2), columns and rows in px, of what is masked in an image (row, column)."""
    found, _ = cv2.findContours(covered.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return [np.asarray(outline[:, 0], np.int32) for outline in found if len(outline) > 2]


class MaskPanel:
    """The clicked corners, by camera or on the water."""

    def __init__(self, session: LookSession, changed: Callable[[], None]) -> None:
        self._session, self._changed = session, changed
        self._corners: list[tuple[str, Corner]] = []  # camera or WATER, corner; in the order of the clicks
        self.words = words_of("mask_words", _HOW, html=True)
        self.undo = Button(label="Remove the last corner", name="mask_undo", disabled=True)
        self.clear = Button(label="Clear", name="mask_clear", disabled=True)
        self.save = Button(label="Save", name="mask_save", button_type="primary", disabled=True)
        self.undo.on_click(lambda: self._keep(self._corners[:-1]))
        self.clear.on_click(lambda: self._keep([]))
        self.save.on_click(self._save)
        buttons = row(self.undo, self.clear, self.save, styles={"flex-wrap": "wrap"})
        self.layout = column(self.words, buttons, sizing_mode="stretch_width")

    def show(self, place: Place) -> None:
        """The corners are the same at every place."""

    def add(self, image: str, corner: Corner) -> None:
        """Add a corner: px in the image of a camera, or metres on the water."""
        if np.isfinite(corner).all():
            self._keep([*self._corners, (image, corner)])

    def polygon(self, image: str) -> list[Corner]:
        """The corners in the image of a camera or on the water."""
        return [corner for name, corner in self._corners if name == image]

    def closed_line(self, image: str) -> dict[str, list[float]]:
        """Those corners as columns x and y of a closed line."""
        corners = self.polygon(image)
        line = [*corners, *corners[:1]]
        return {"x": [float(x) for x, _ in line], "y": [float(y) for _, y in line]}

    def _polygons(self) -> dict[str, list[Corner]]:
        return {name: self.polygon(name) for name in dict.fromkeys(name for name, _ in self._corners)}

    def _complete(self) -> bool:
        return all(len(corners) >= 3 for corners in self._polygons().values())

    def _keep(self, corners: list[tuple[str, Corner]]) -> None:
        self._corners = corners
        polygons = self._polygons()
        counts = "; ".join(
            f"{'the water' if name == WATER else name}: {len(c)} corner{'s' if len(c) > 1 else ''}"
            for name, c in polygons.items()
        )
        self.words.text = f"{counts}. The last corner joins the first." if counts else _HOW
        self.undo.disabled = self.clear.disabled = not corners
        self.save.disabled = not corners or not self._complete()
        self._changed()

    def _save(self) -> None:
        if not self._corners or not self._complete():  # a browser can press a button that is disabled
            return
        experiment = self._session.run.experiment
        if experiment is None:
            reason = plain(self._session.run.reason("experiment"))
            self.words.text = f"There is no experiment file to save masks in: {reason}"
            return
        try:
            add_polygons(experiment, self._polygons())
        except WavefieldError as error:
            self.words.text = alert(error)
            return
        self._session.reopen()
        self._keep([])
        file = plain(experiment.path.absolute())
        command = plain(shlex.quote(str(experiment.path.absolute())))
        self.words.text = (
            f"Saved in {file}. This cube was measured without the mask: "
            f"<code>wavefield run {command} -o masked.zarr</code> measures again."
        )
