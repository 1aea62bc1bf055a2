"""Over a rectangle: means, histogram, E(omega)."""

import numpy as np
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, Div

from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import shown_as
from wavefield.explorer.place import Place
from wavefield.explorer.plot_parts import BLUE, band, envelope, make_figure, number
from wavefield.explorer.selections import area, span


class AreaPanel:
    """What a rectangle of the map holds, over the whole record."""

    def __init__(self, record: CubeRecord) -> None:
        self._record = record
        self.words = Div(
            text="Choose \u201crectangle\u201d for dragging (key R) and drag over the map.",
            name="area_words", sizing_mode="stretch_width",
        )  # fmt: skip
        self.mean = ColumnDataSource({"t": [], "mean": [], "low": [], "high": []}, name="area_mean")
        self.bins = ColumnDataSource({"left": [], "right": [], "density": []}, name="area_bins")
        self.density = ColumnDataSource({"f": [], "e": [], "low": [], "high": []}, name="area_spectrum")
        self.figures = [
            make_figure("area_mean_figure", height=210, x_axis_label="t (s)"),
            make_figure("area_histogram", height=210, tools="pan,wheel_zoom,reset"),
            make_figure(
                "area_spectrum_figure", height=230, x_axis_type="log", y_axis_type="log",
                x_axis_label="frequency (Hz)", tools="pan,wheel_zoom,reset",
            ),
        ]  # fmt: skip
        means, bars, lines = self.figures
        means.varea("t", "low", "high", source=self.mean, fill_color=BLUE, fill_alpha=0.22)
        means.line("t", "mean", source=self.mean, color=BLUE, line_width=1.2)
        bars.quad("left", "right", "density", 0, source=self.bins, fill_color=BLUE, line_color="white")
        lines.varea("f", "low", "high", source=self.density, fill_color=BLUE, fill_alpha=0.22)
        lines.line("f", "e", source=self.density, color=BLUE, line_width=1.6)
        self._drawn: tuple[object, ...] = ()
        self.layout = column(self.words, *self.figures, sizing_mode="stretch_width")

    def show(self, place: Place) -> None:
        """Show the rectangle of a place."""
        record, preview = self._record, self._record.preview
        name = place.show if place.show in preview.thin.names and place.show != "quality" else "w"
        key = (place.area, name, int(preview.known.sum()))
        if place.area is None or key == self._drawn:
            return
        self._drawn = key
        x0, y0, x1, y1 = place.area
        shown = shown_as(name, record.units(name))
        rows, columns = span(preview.y, y0, y1), span(preview.x, x0, x1)
        found = area(
            preview.stored(name)[rows, columns], preview.scale(name) * shown.factor, 1.0 / record.frame_rate
        )
        t, mean, std = envelope(record.time, found.mean, found.std)
        low, high = band(mean, std, thinned=t.size < record.time.size)
        self.mean.data = {"t": t, "mean": mean, "low": low, "high": high}
        self.bins.data = {"left": found.edges[:-1], "right": found.edges[1:], "density": found.density}
        means, bars, lines = self.figures
        means.yaxis.axis_label = f"mean of {name}{shown.suffix}"
        bars.xaxis.axis_label = f"{name}{shown.suffix}"
        bars.yaxis.axis_label = "probability density"
        lines.yaxis.axis_label = f"E ({shown.unit})\u00b2/Hz"
        self.density.data = {"f": [], "e": [], "low": [], "high": []}
        if found.spectrum is not None:
            e = found.spectrum.density
            least, most = found.spectrum.low, found.spectrum.high
            self.density.data = {"f": found.spectrum.frequency, "e": e, "low": e * least, "high": e * most}
            lines.title.text = f"95 % as of one node: factor {number(least, 2)} to {number(most, 2)}"
        else:
            lines.title.text = "too short a record without gaps for a spectrum"
        finite = np.isfinite(found.mean)
        whole = float(np.average(found.mean[finite])) if finite.any() else float("nan")
        self.words.text = (
            f"<b>{name}, x {number(min(x0, x1))} to {number(max(x0, x1))} m, y {number(min(y0, y1))} to "
            f"{number(max(y0, y1))} m:</b> mean {number(whole)} {shown.unit}; {found.nodes} nodes of the "
            f"preview, {found.count} values; the band is one standard deviation over the rectangle."
        )
