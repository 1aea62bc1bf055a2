"""Files of what is shown: the map as a picture, the node's series and the step's fields as tables."""

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from bokeh.layouts import column
from jinja2 import Environment
from numpy.typing import NDArray

from wavefield.errors import StoreError
from wavefield.explorer.map import arrows, top_speed
from wavefield.explorer.parts import Place, words_of
from wavefield.explorer.record import CubeRecord, nearest
from wavefield.figures.display import KINDS, display, drawn_kind

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

_TABLE = Environment(autoescape=True).from_string(
    """<table>{% for title, links in rows %}<tr><td style="padding: 3px 12px 3px 0">{{ title }}</td><td>
{%- for words, href in links %} <a style="padding: 0 6px" href="{{ href }}"
{%- if words != "link" %} download{% endif %}>{{ words }}</a>{% endfor %}</td></tr>{% endfor %}</table>"""
)


class SavePanel:
    """Links that the server answers with files made from the cube."""

    def __init__(self) -> None:
        self.words = words_of("save_words", html=True)
        self.layout = column(self.words, sizing_mode="stretch_width")

    def show(self, place: Place) -> None:
        """List what can be saved of a place."""
        query = place.query()
        rows = [
            ("This map", [("PNG", f"save/map.png?{query}"), ("SVG", f"save/map.svg?{query}")]),
            ("This step, all variables", [("NetCDF", f"save/step.nc?{query}")]),
        ]
        if place.node:
            links = [("CSV", f"save/node.csv?{query}"), ("NetCDF", f"save/node.nc?{query}")]
            rows.append(("Series at the node", links))
        rows.append(("This view", [("link", f"?{query}")]))
        self.words.text = _TABLE.render(rows=rows)


def draw(record: CubeRecord, place: Place) -> "Figure":
    """The map as a figure."""
    import xarray as xr

    from wavefield.figures.style import draw_map, map_panels

    shown = display(place.show)
    values = record.field(place.show, place.step) * np.float32(shown.factor)
    limits = place.limits or shown.limits(values)
    if place.show == "quality":
        values, limits = drawn_kind(record.field("quality", place.step)), (0.0, float(len(KINDS) - 1))
    field = xr.DataArray(values, dims=("y", "x"), coords={"y": record.y, "x": record.x})
    figure, [[ax]] = map_panels(field, 1, width=7.0)
    title = f"{record.experiment}, t = {record.time[place.step]:.3f} s"
    label = shown.long_name + shown.in_unit
    draw_map(ax, field, label, cmap=place.colour_map, scale=limits, title=title)
    if place.overlay != "nothing" and {"u", "v"} <= set(record.stored):
        u, v = (record.field(name, place.step) for name in "uv")
        xs, ys, _ = arrows(u, v, record.x, record.y, top_speed(u, v))
        ax.plot(xs, ys, color="black", linewidth=0.7)
    return figure


def picture(record: CubeRecord, place: Place, kind: str) -> bytes:
    """The map as a PNG or SVG file."""
    from wavefield.figures.style import file_of

    return file_of(draw(record, place), kind, dpi=160)


def node_series(record: CubeRecord, place: Place) -> "xr.Dataset":
    """Every stored variable at the picked node, (time,), from the preview."""
    if place.node is None:
        raise StoreError("no node is picked: click one on the map")
    preview = record.preview
    j, i = nearest(preview.y, place.node[1]), nearest(preview.x, place.node[0])
    variables = {name: ("time", preview.series(name, j, i)) for name in preview.thin.names}
    return _labelled(variables, {"time": record.time, "x": preview.x[i], "y": preview.y[j]}, record)


def step_fields(record: CubeRecord, place: Place) -> "xr.Dataset":
    """Every variable at the displayed step, (y, x)."""
    variables = {name: (("y", "x"), record.field(name, place.step)) for name in record.names}
    coords = {"time": float(record.time[place.step]), "y": record.y, "x": record.x}
    return _labelled(variables, coords, record)


def _labelled(
    variables: Mapping[str, tuple[object, NDArray[np.floating]]],
    coords: Mapping[str, object],
    record: CubeRecord,
) -> "xr.Dataset":
    import xarray as xr

    out = record.annotated(xr.Dataset(variables, coords=coords))
    for variable in out.variables.values():
        variable.attrs.pop("ancillary_variables", None)
    out.attrs = {"experiment": record.experiment, "cube": record.path.name, "frame_rate": record.frame_rate}
    return out


def as_netcdf(dataset: "xr.Dataset") -> bytes:
    """A dataset as a NetCDF-4 file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.nc"
        dataset.to_netcdf(path, engine="h5netcdf")
        return path.read_bytes()


def as_csv(dataset: "xr.Dataset") -> bytes:
    """A dataset of one dimension as a table with units in its first line."""
    frame = dataset.drop_vars("path_frames", errors="ignore").to_dataframe()
    units = [dataset[name].attrs.get("units", "") for name in frame.columns]
    frame.columns = [f"{n} ({u})" if u not in ("", "1") else str(n) for n, u in zip(frame.columns, units)]
    return bytes(frame.to_csv().encode())


# name: content type, function of the cube and the place
FILES: dict[str, tuple[str, Callable[[CubeRecord, Place], bytes]]] = {
    "map.png": ("image/png", lambda record, place: picture(record, place, "png")),
    "map.svg": ("image/svg+xml", lambda record, place: picture(record, place, "svg")),
    "node.csv": ("text/csv", lambda record, place: as_csv(node_series(record, place))),
    "node.nc": ("application/x-netcdf", lambda record, place: as_netcdf(node_series(record, place))),
    "step.nc": ("application/x-netcdf", lambda record, place: as_netcdf(step_fields(record, place))),
}
