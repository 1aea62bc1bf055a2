"""The widgets above the views of `wavefield look`."""

from bokeh.layouts import column, row
from bokeh.models import Button, ColumnDataSource, CustomJS, NumericInput, Select, Slider, Toggle, Widget

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.place import AVERAGES, COLOUR_MAPS, DRAGS, OVERLAYS, Place
from wavefield.explorer.plot_parts import words_of
from wavefield.variables import TABLE

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
    """Variable, steps and playback above the page; colours, overlay and drag mode above the views."""

    def __init__(self, record: CubeRecord, place: Place) -> None:
        low = {"align": "end"}
        options = [(name, f"{name}: {TABLE[name].long_name}") for name in record.names]
        self.variable = Select(title="Map of", value=place.show, options=options, name="show", width=230)
        self.average = Select(
            title="Over time", value=place.average, options=list(AVERAGES.items()), name="average", width=130
        )
        self.period = NumericInput(
            title="Period (s)", value=place.period, mode="float", low=0.0, name="period", width=85,
            visible=place.average == "phase",
        )  # fmt: skip
        self.step = Slider(
            title="Step", start=0, end=max(record.layout.steps - 1, 1), value=place.step, step=1, name="step",
            sizing_mode="stretch_width", show_value=False, min_width=240,
        )  # fmt: skip
        self.play = Toggle(label="Play", name="play", width=70, **low)
        back = Button(label="◀", name="back", width=40, **low)
        forward = Button(label="▶", name="forward", width=40, **low)
        for button, by in ((back, -1), (forward, 1)):
            button.js_on_click(CustomJS(args={"step": self.step, "by": by}, code=_STEP))
        colour_maps = [(name, name or "automatic") for name in COLOUR_MAPS]
        self.colours = Select(
            title="Colour map", value=place.colours, options=colour_maps, name="colours", width=105
        )
        self.low = NumericInput(title="Colours from", mode="float", name="low", width=90)
        self.high = NumericInput(title="to", mode="float", name="high", width=80)
        self.fit = Button(label="Fit", name="fit", width=46, **low)
        self.log = Toggle(label="Log", active=place.log, name="log", width=50, **low)
        self.overlay = Select(
            title="Overlay", value=place.overlay, options=list(OVERLAYS), name="overlay", width=115
        )
        self.drag = Select(
            title="Drag mode", value=place.drag, options=list(DRAGS.items()), name="drag", width=105
        )
        self.link = words_of("link", place.query())
        self.link.visible = False
        self.link.js_on_change("text", CustomJS(code=_LINK))
        self.layout = column(
            row(
                self.variable, self.average, self.period, back, self.play, forward, self.step,
                sizing_mode="stretch_width", styles=_WRAP,
            ),
            self.link, name="controls", sizing_mode="stretch_width",
        )  # fmt: skip
        self.options = row(
            self.colours, self.low, self.high, self.fit, self.log, self.overlay, self.drag,
            name="options", sizing_mode="stretch_width", styles=_WRAP,
        )  # fmt: skip

    def play_on(self, image: ColumnDataSource) -> None:
        """Play with each image that arrives in a source."""
        play = CustomJS(args={"play": self.play, "step": self.step}, code=_PLAY)
        self.play.js_on_change("active", play)
        image.js_on_change("data", play)

    @property
    def of_scale(self) -> tuple[Widget, ...]:
        """The widgets of the colour scale."""
        return self.colours, self.low, self.high, self.fit, self.log

    @property
    def limits(self) -> tuple[float, float] | None:
        """The limits of the colours that are entered, if they are valid."""
        low, high = self.low.value, self.high.value
        return (float(low), float(high)) if low is not None and high is not None and low < high else None
