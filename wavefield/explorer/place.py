"""What a page shows, as the query of the link that shows it again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from urllib.parse import urlencode

from wavefield.figures.display import display

TABS = ("map", "surface", "cameras", "waves")
COLOUR_MAPS = ("", "RdBu_r", "cividis", "viridis", "inferno", "turbo", "gray")  # "": that of the variable
OVERLAYS = ("arrows", "nothing")  # drawn on the map
_CHOICES = {"tab": TABS, "colours": COLOUR_MAPS, "overlay": OVERLAYS}
Value = str | int | tuple[float, ...] | None


@dataclass(frozen=True)
class Place:
    """A view of a cube: show=z&step=12&node=0.1,-0.2."""

    show: str = "w"  # variable of the map
    step: int = 0  # index of the step
    tab: str = "map"  # one of TABS
    limits: tuple[float, float] | None = None  # of the colour scale, in the displayed unit; None: fitted
    colours: str = ""  # one of COLOUR_MAPS
    overlay: str = "arrows"  # one of OVERLAYS
    node: tuple[float, float] | None = None  # x and y of the clicked node, metres

    @property
    def coloured(self) -> str:
        """The variable where one with a scale is needed: w in place of the quality."""
        return "w" if self.show == "quality" else self.show

    @property
    def colour_map(self) -> str:
        """The matplotlib colour map of the displayed variable."""
        return self.colours or display(self.coloured).colour_map

    def query(self) -> str:
        """The part of a link after the question mark; defaults are left out."""
        pairs = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple):
                pairs[field.name] = ",".join(f"{number:.6g}" for number in value)
            elif field.name in ("show", "step") or value != field.default:
                pairs[field.name] = str(value)
        return urlencode(pairs, safe=",")

    @classmethod
    def read(
        cls, query: Mapping[str, str], names: Sequence[str] = (), steps: int = 0, first: int = 0
    ) -> "Place":
        """Inverse of `query` for a cube with these variables and steps; ignores what is not valid."""
        out = cls(step=first, show="w" if "w" in names or not names else names[0])
        choices = _CHOICES | {"show": tuple(names)}
        for name, text in query.items():
            value = _parse(name, text, choices)
            if value is not None:
                out = replace(out, **{name: value})  # type: ignore[arg-type]  # _parse gives each its type
        return replace(out, step=min(max(out.step, 0), steps - 1)) if steps else out


def _parse(name: str, text: str, choices: Mapping[str, Sequence[str]]) -> Value:
    """A part of a query as a value of its field; None if it is not valid."""
    try:
        if name == "step":
            return int(text)
        if name in ("limits", "node"):
            a, b = (float(part) for part in text.split(","))
            valid = abs(a) < 1e6 and abs(b) < 1e6 and (name == "node" or a < b)
            return (a, b) if valid else None
    except ValueError:
        return None
    allowed = choices.get(name, ("",))  # an unknown name has no valid value but the default
    return text if text and (text in allowed or not allowed) else None
