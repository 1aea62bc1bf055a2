"""What a page shows, as the link that shows it again."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from urllib.parse import urlencode

from wavefield.figures.display import POSITIVE, SIGNED, display

TABS = ("map", "surface", "cameras", "waves")
AVERAGES = {
    "": "this step",
    "mean": "mean over time",
    "rms": "rms over time",
    "phase": "phase average",
}  # as they are called
COLOUR_MAPS = ("", "RdBu_r", "cividis", "viridis", "inferno", "turbo", "gray")  # "": that of the variable
OVERLAYS = ("arrows", "streamlines", "nothing")  # of the velocity, on the map
MAX_MOVIE_FRAMES = 2000
DRAGS = {"move": "pan", "line": "line", "rectangle": "rectangle", "mask": "mask"}  # as they are called
_COUNTS = {"limits": 2, "node": 2, "line": 4, "area": 4}  # of numbers
Value = str | int | float | bool | tuple[float, ...] | None


@dataclass(frozen=True)
class Place:
    """A view of a cube, as the query of an address: show=z&step=12&node=0.1,-0.2."""

    show: str = "w"  # variable of the map
    step: int = 0  # index of the step
    tab: str = "map"  # one of `TABS`
    limits: tuple[float, float] | None = None  # of the colour scale, in the displayed unit; None: fitted
    average: str = ""  # over time, on the map, one of `AVERAGES`
    period: float | None = None  # of the phase averages, s
    colours: str = ""  # one of `COLOUR_MAPS`
    log: bool = False  # whether the colours of the map are logarithmic, of magnitudes
    overlay: str = "arrows"  # one of `OVERLAYS`
    node: tuple[float, float] | None = None  # x and y of the clicked node, metres
    line: tuple[float, float, float, float] | None = None  # its ends x0, y0, x1, y1, metres
    area: tuple[float, float, float, float] | None = None  # opposite corners of the rectangle, metres

    @property
    def averaged(self) -> str:
        """The average over time that the map shows: the quality, a bit mask, has none."""
        return "" if self.show == "quality" else self.average

    def of_step(self) -> "Place":
        """This place as panels see it that show single steps: without averages, logarithms, quality."""
        shown = replace(self, show=self.coloured, average="", log=False)
        return shown if shown == self else replace(shown, limits=None)

    @property
    def signed(self) -> bool:
        """Whether what the map shows has a sign, so that its colours are balanced about zero."""
        return display(self.show).signed and self.averaged != "rms" and not self.log

    @property
    def colour_map(self) -> str:
        """The colour map of the map."""
        return self.colours or (SIGNED if self.signed else POSITIVE)

    @property
    def coloured(self) -> str:
        """The variable where one with a scale is needed: w in place of the quality."""
        return "w" if self.show == "quality" else self.show

    def query(self) -> str:
        """The part of a link after the question mark, without the defaults."""
        pairs = {}
        for name, default in asdict(Place()).items():
            value = getattr(self, name)
            if value is None or (value == default and name not in ("show", "step")):
                continue
            if isinstance(value, tuple):
                pairs[name] = ",".join(f"{number:.6g}" for number in value)
            else:
                pairs[name] = str(int(value)) if isinstance(value, bool) else str(value)
        return urlencode(pairs, safe=",")

    @classmethod
    def read(
        cls, query: Mapping[str, str], names: Sequence[str] = (), steps: int = 0, first: int = 0
    ) -> "Place":
        """Inverse of `query` for a cube with these variables and steps; ignores what is not valid."""
        out = cls(step=first, show="w" if "w" in names or not names else names[0])
        allowed = {
            "show": names, "tab": TABS, "average": tuple(AVERAGES), "colours": COLOUR_MAPS,
            "overlay": OVERLAYS,
        }  # fmt: skip
        for name, text in query.items():
            value = _parse(name, text)
            if value is not None and (not allowed.get(name) or value in allowed[name]):
                out = replace(out, **{name: value})  # type: ignore[arg-type]  # _parse gives each its type
        return replace(out, step=min(max(out.step, 0), steps - 1)) if steps else out


def _parse(name: str, text: str) -> Value:
    """A part of a query as a value of its field; None if it is not valid."""
    try:
        if name in _COUNTS:
            numbers = tuple(float(part) for part in text.split(","))
            valid = len(numbers) == _COUNTS[name] and all(abs(number) < 1e6 for number in numbers)
            valid = valid and (name != "limits" or numbers[0] < numbers[1])
            return numbers if valid else None
        if name == "period":
            return float(text) if 0 < float(text) < 1e6 else None
        if name == "step":
            return int(text)
    except ValueError:
        return None
    if name == "log":
        return text != "0"
    return text if name in ("show", "tab", "average", "colours", "overlay") else None
