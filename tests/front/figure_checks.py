"""Faults of the text of a figure: crossed by a line, over other text, or cut off."""

from collections.abc import Iterator
from itertools import combinations

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox, BboxBase
from mpl_toolkits.mplot3d.axes3d import Axes3D

TOLERANCE = 1.0  # px, by which boxes of text are larger than their letters


def text_faults(figure: Figure) -> list[str]:
    """Return the faults of the text of a figure; 3D axes and text on its own background are not checked."""
    FigureCanvasAgg(figure).draw()
    hidden = {label for axes in figure.findobj(Axes) for label in _undrawn(axes)}
    texts = [(text, text.get_text().strip()) for text in figure.findobj(Text) if text not in hidden]
    boxes = [
        (text, words, box) for text, words in texts if words and text.get_visible() if (box := _box(text))
    ]
    faults = [f"{words!r} is cut off" for _, words, box in boxes if not _inside(box, figure.bbox)]
    faults += [
        f"{one!r} overlaps {other!r}"
        for (_, one, a), (_, other, b) in combinations(boxes, 2)
        if _area(Bbox.intersection(a, b))
    ]
    for axes in figure.axes:
        lines = [line for line in axes.lines if line.get_visible() and line.get_linestyle() != "None"]
        for text, words, box in boxes:
            part = Bbox.intersection(box, axes.bbox)
            if _area(part) and text.get_bbox_patch() is None and any(_crosses(line, part) for line in lines):
                faults.append(f"a line runs through {words!r}")
    return faults


def _undrawn(axes: Axes) -> Iterator[Text]:
    """Return the text of axes that is not checked: ticks outside, and all text of 3D or hidden axes."""
    if isinstance(axes, Axes3D) or not axes.axison:
        parts = [axes.xaxis, axes.yaxis, *([axes.zaxis] if isinstance(axes, Axes3D) else [])]
        yield from (text for axis in parts for text in axis.findobj(Text))
        return
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not low - 1e-9 * abs(low) <= tick.get_loc() <= high + 1e-9 * abs(high):
                yield from (tick.label1, tick.label2)


def _box(text: Text) -> BboxBase | None:
    box = text.get_window_extent()
    return box.padded(-TOLERANCE) if min(box.width, box.height) > 2 * TOLERANCE else None


def _inside(box: BboxBase, whole: BboxBase) -> bool:
    return box.x0 >= whole.x0 and box.y0 >= whole.y0 and box.x1 <= whole.x1 and box.y1 <= whole.y1


def _area(box: BboxBase | None) -> float:
    return 0.0 if box is None else float(box.width * box.height)


def _crosses(line: Line2D, box: BboxBase) -> bool:
    return bool(line.get_transform().transform_path(line.get_path()).intersects_bbox(box, filled=False))
