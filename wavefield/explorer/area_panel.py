"""Over a rectangle: means, histogram, E(omega)."""

import numpy as np
from bokeh.layouts import column

from wavefield.explorer import plot_parts as parts
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.node_spectrum import show_spectrum, spectrum_figure
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import number
from wavefield.explorer.selections import area, span
from wavefield.figures.display import display


class AreaPanel:
    """Values in a rectangle of the map, over the whole record."""

    def __init__(self, record: CubeRecord) -> None:
        self._record = record
        self._drawn: tuple[object, ...] = ()
        self.words = parts.words_of(
            "area_words", "Choose “rectangle” for dragging (key R) and drag over the map.", html=True
        )
        self.sources = parts.make_sources(
            "area", mean="t mean low high", bins="left right density", spectrum="f e low high"
        )
        self.means = parts.make_figure("area_mean_figure", height=210, x_axis_label="t (s)")
        parts.draw_band(self.means, self.sources["mean"], "t", "mean", line_width=1.2)
        parts.add_hover(self.means, renderers=self.means.renderers[1:2], mode="vline")
        self.histogram = parts.make_figure(
            "area_histogram", height=210, tools="pan,wheel_zoom,reset", y_axis_label="probability density"
        )
        colours = {"fill_color": parts.BLUE, "line_color": "white"}
        self.histogram.quad("left", "right", "density", 0, source=self.sources["bins"], **colours)
        self.spectrum = spectrum_figure("area_spectrum_figure", self.sources["spectrum"], 230)
        self.layout = column(
            self.words, self.means, self.histogram, self.spectrum, sizing_mode="stretch_width"
        )

    def show(self, place: Place) -> None:
        """Show the rectangle of a place."""
        record, preview = self._record, self._record.preview
        name = place.show if place.show in preview.thin.names and place.show != "quality" else "w"
        drawn = (place.area, name, preview.count)
        if place.area is None or drawn == self._drawn:
            return
        self._drawn = drawn
        x0, y0, x1, y1 = place.area
        shown = display(name)
        rows, columns = span(preview.y, y0, y1), span(preview.x, x0, x1)
        found = area(
            preview.stored(name)[rows, columns], preview.scale(name) * shown.factor, 1.0 / record.frame_rate
        )
        t, mean, std = parts.envelope(record.time, found.mean, found.std)
        low, high = parts.band(mean, std, thinned=t.size < record.time.size)
        self.sources["mean"].data = {"t": t, "mean": mean, "low": low, "high": high}
        bins = {"left": found.edges[:-1], "right": found.edges[1:]}
        self.sources["bins"].data = bins | {"density": found.density}
        self.means.hover.tooltips = [("t", "@t{0.000} s"), (f"mean {name}", f"@mean{{0.[000]}} {shown.unit}")]
        self.means.yaxis.axis_label = f"mean of {shown.label}"
        self.histogram.xaxis.axis_label = shown.label
        words = "95 % interval of a single node"
        show_spectrum(self.spectrum, self.sources["spectrum"], found.spectrum, shown, words)
        finite = np.isfinite(found.mean)
        overall = float(np.average(found.mean[finite])) if finite.any() else float("nan")
        self.words.text = (
            f"<b>{name}, x {number(min(x0, x1))} to {number(max(x0, x1))} m, y {number(min(y0, y1))} to "
            f"{number(max(y0, y1))} m:</b> mean {number(overall)} {shown.unit}; {found.nodes} nodes of the "
            f"preview, {found.count} values; the band is one standard deviation over the rectangle."
        )
