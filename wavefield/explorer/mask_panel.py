"""A mask drawn on the map: corners clicked one by one, saved as the lines of an experiment file."""

from typing import Any

from bokeh.layouts import column, row
from bokeh.models import Button, Div, PreText


def mask_yaml(corners: list[tuple[float, float]]) -> str:
    """A polygon as the experiment file wants it.

    Parameters
    ----------
    corners : list of (x, y)
        On the water, metres.

    Returns
    -------
    str

    Examples
    --------
    >>> print(mask_yaml([(0.1, 0.2), (0.3, 0.2), (0.3, 0.41)]))
    mask:
      - {polygon: [[0.1, 0.2], [0.3, 0.2], [0.3, 0.41]]}
    """
    points = ", ".join(f"[{x:.4g}, {y:.4g}]" for x, y in corners)
    return f"mask:\n  - {{polygon: [{points}]}}"


class MaskPanel:
    """Corners of a polygon.

    Parameters
    ----------
    drawn : ColumnDataSource
        x and y of the corners, as the map draws them.
    """

    def __init__(self, drawn: Any) -> None:
        self._drawn = drawn
        self.corners: list[tuple[float, float]] = []
        self.words = Div(
            text="Choose \u201cmask\u201d for dragging (key M) and click the corners of what is not water "
            "in order. Copy the lines below into the experiment file and run it into a new cube: masked "
            "nodes get a quality bit of their own, are never filled and belong to no spectrum.",
            sizing_mode="stretch_width",
        )
        self.undo = Button(label="Take back the last corner", name="mask_undo")
        self.clear = Button(label="Start again", name="mask_clear")
        self.text = PreText(text="", name="mask_text", sizing_mode="stretch_width")
        self.undo.on_click(lambda: self._set(self.corners[:-1]))
        self.clear.on_click(lambda: self._set([]))
        self.layout = column(self.words, row(self.undo, self.clear), self.text, sizing_mode="stretch_width")

    def add(self, corner: tuple[float, float]) -> None:
        """Add a corner.

        Parameters
        ----------
        corner : (x, y)
            Metres.
        """
        self._set([*self.corners, corner])

    def _set(self, corners: list[tuple[float, float]]) -> None:
        self.corners = corners
        self._drawn.data = {"x": [c[0] for c in corners], "y": [c[1] for c in corners]}
        self.text.text = mask_yaml(corners) if len(corners) >= 3 else ""
