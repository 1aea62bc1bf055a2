"""The widgets above the views of `wavefield look`."""

from bokeh.layouts import column, row
from bokeh.models import Button, ColumnDataSource, CustomJS, NumericInput, Select, Slider, Toggle, Widget

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.place import AVERAGES, COLOUR_MAPS, DRAGS, OVERLAYS, Place, Value
from wavefield.explorer.plot_parts import chosen, named, words_of

# Playback in the browser: the next step is requested when this one has arrived, so that no requests pile up.
_PLAY = """
const next = () => {
  if (!play.active) return
  const wait = Math.max(0, 80 - (performance.now() - (play._asked ?? 0)))
  setTimeout(() => {
    if (!play.active) return
    play._asked = performance.now()
    step.value = step.value >= step.end ? step.start : step.value + 1
  }, wait)
}
if (cb_obj === play) { play.label = play.active ? "Pause" : "Play"; next() }
else if (play.active) requestAnimationFrame(next)
"""
_STEP = "step.value = Math.max(step.start, Math.min(step.end, step.value + by))"
_LINK = 'history.replaceState(null, "", location.pathname + "?" + cb_obj.text)'
_WRAP = {"flex-wrap": "wrap"}


class LookControls:
    """The widgets by name; those that show a part of the place have the name of its field."""

    def __init__(self, record: CubeRecord, place: Place) -> None:
        low, phase = {"align": "end"}, place.average == "phase"
        maps = [(name, name or "automatic") for name in COLOUR_MAPS]
        averages, drags = list(AVERAGES.items()), list(DRAGS.items())
        above = [
            Select(name="show", title="Map of", value=place.show, options=named(record.names), width=230),
            Select(name="average", title="Over time", value=place.average, options=averages, width=130),
            NumericInput(
                name="period", title="Period (s)", value=place.period, mode="float", low=0.0, width=85,
                visible=phase,
            ),
            Button(name="back", label="◀", width=40, **low),
            Toggle(name="play", label="Play", width=70, **low),
            Button(name="forward", label="▶", width=40, **low),
            Slider(
                name="step", title="Step", start=0, end=max(record.layout.steps - 1, 1), value=place.step,
                step=1, sizing_mode="stretch_width", show_value=False, min_width=240,
            ),
        ]  # fmt: skip
        scale = [
            Select(name="colours", title="Colour map", value=place.colours, options=maps, width=105),
            NumericInput(name="low", title="Colours from", mode="float", width=90),
            NumericInput(name="high", title="to", mode="float", width=80),
            Button(name="fit", label="Fit", width=46, **low),
            Toggle(name="log", label="Log", active=place.log, width=50, **low),
        ]
        beside = [
            Select(name="overlay", title="Overlay", value=place.overlay, options=list(OVERLAYS), width=115),
            Select(name="drag", title="Drag mode", value="move", options=drags, width=105),
        ]
        self._steps = record.layout.steps
        self._widgets: dict[str, Widget] = {str(one.name): one for one in (*above, *scale, *beside)}
        self.of_scale = scale
        for name, by in (("back", -1), ("forward", 1)):
            self[name].js_on_click(CustomJS(args={"step": self["step"], "by": by}, code=_STEP))
        self.link = words_of("link", place.query())
        self.link.visible = False
        self.link.js_on_change("text", CustomJS(code=_LINK))
        wide = {"sizing_mode": "stretch_width"}
        self.layout = column(row(*above, **wide, styles=_WRAP), self.link, name="controls", **wide)
        self.options = row(*scale, *beside, name="options", **wide, styles=_WRAP)

    def __getitem__(self, name: str) -> Widget:
        return self._widgets[name]

    def entered(self, name: str) -> Value:
        """What a widget holds, if that is valid: a browser can send anything."""
        widget = self[name]
        if isinstance(widget, Select):
            return chosen(widget)
        if isinstance(widget, Toggle):
            return bool(widget.active)
        if isinstance(widget, Slider):
            return int(min(max(widget.value, 0), self._steps - 1))
        return float(widget.value) if widget.value else None

    def play_on(self, image: ColumnDataSource) -> None:
        """Play with each image that arrives in a source."""
        play = CustomJS(args={"play": self["play"], "step": self["step"]}, code=_PLAY)
        self["play"].js_on_change("active", play)
        image.js_on_change("data", play)

    @property
    def limits(self) -> tuple[float, float] | None:
        """The limits of the colours that are entered, if they are valid."""
        low, high = self["low"].value, self["high"].value
        return (float(low), float(high)) if low is not None and high is not None and low < high else None
