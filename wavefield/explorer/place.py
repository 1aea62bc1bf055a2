"""What somebody looks at, as the link that shows it again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import urlencode

TABS = ("map", "surface", "cameras", "waves")
DRAGS = ("move", "line", "rectangle", "mask")


@dataclass(frozen=True)
class Place:
    """A view of a cube.

    Examples
    --------
    >>> Place(show="z", step=12, node=(0.1, -0.2)).query()
    'show=z&step=12&node=0.1,-0.2'
    >>> Place.read({"show": "z", "step": "12", "node": "0.1,-0.2"}).node
    (0.1, -0.2)
    """

    show: str = "w"  # Variable of the map
    step: int = 0  # Index of the step
    tab: str = "map"  # One of `TABS`
    drag: str = "move"  # What dragging does, one of `DRAGS`
    # (float, float): Ends of the colour scale in the shown unit; None for those that fit
    limits: tuple[float, float] | None = None
    arrows: bool = True  # Whether velocity arrows are drawn
    node: tuple[float, float] | None = None  # (float, float): The clicked node, x and y in metres
    # (float, float, float, float): Ends of the line, corners of the rectangle: x0, y0, x1, y1 in metres
    line: tuple[float, float, float, float] | None = None
    area: tuple[float, float, float, float] | None = None
    camera: str = ""  # Camera whose frame is shown

    def query(self) -> str:
        """The part of a link after the question mark; what is as usual is left out."""
        pairs: list[tuple[str, str]] = []
        for name, usual in vars(Place()).items():
            value = getattr(self, name)
            if value is None or (value == usual and name not in ("show", "step")):
                continue
            if isinstance(value, tuple):
                pairs.append((name, ",".join(f"{number:.6g}" for number in value)))
            else:
                pairs.append((name, str(int(value)) if isinstance(value, bool) else str(value)))
        return urlencode(pairs, safe=",")

    @classmethod
    def read(
        cls, query: Mapping[str, Any], names: Sequence[str] = (), steps: int = 0, first: int = 0
    ) -> "Place":
        """Inverse of `query`; what makes no sense is passed over."""
        out = cls(step=first)
        if names:
            out = replace(out, show="w" if "w" in names else names[0])
        for name, text in query.items():
            if not isinstance(text, str):
                continue
            value = _parse(name, text)
            if value is not None and _fits(name, value, names):
                out = replace(out, **{name: value})
        last = max(steps - 1, 0)
        return replace(out, step=min(max(out.step, 0), last) if steps else out.step)


_NUMBERS = {"limits": 2, "node": 2, "line": 4, "area": 4}


def _parse(name: str, text: str) -> Any:
    try:
        if name in _NUMBERS:
            numbers = tuple(float(part) for part in text.split(","))
            sound = len(numbers) == _NUMBERS[name] and all(abs(n) < 1e6 for n in numbers)
            return numbers if sound else None
        if name == "step":
            return int(text)
        if name == "arrows":
            return text != "0"
    except ValueError:
        return None
    return text if name in ("show", "tab", "drag", "camera") else None


def _fits(name: str, value: Any, names: Sequence[str]) -> bool:
    allowed = {"show": names, "tab": TABS, "drag": DRAGS}.get(name, ())
    if name == "limits":
        return bool(value[0] < value[1])
    return not allowed or value in allowed
