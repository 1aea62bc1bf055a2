"""Files of what is shown: pictures, movies, tables. Pure functions of the cube and the place."""

import io
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wavefield.errors import StoreError
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.map_fields import arrows, colour_limits, streamlines, top_speed
from wavefield.explorer.place import AVERAGES, MAX_MOVIE_FRAMES, Place
from wavefield.explorer.selections import decode, interpolate, line_points, nearest, span
from wavefield.explorer.whole_record import averages, derived_series, index_of, request_of
from wavefield.figures.display import display
from wavefield.figures.quality_kinds import KINDS, drawn_kind
from wavefield.figures.style import draw_map, file_of, map_panels
from wavefield.variables import CUBE_DIMS

MAX_FRAMES_PER_S = 25.0
Pictures = Iterator[NDArray[np.uint8]]  # (row, column, 3): red first


def draw(
    record: CubeRecord, place: Place, limits: tuple[float, float] | None = None, fastest: float = 0.0
) -> Figure:
    """The map as a figure; colours between limits in the displayed unit, longest arrows of `fastest` m/s."""
    shown = display(place.show)
    fields = map_of(record, place)
    values = fields[place.show]
    if place.show == "quality":
        values = drawn_kind(values)
        limits = (0.0, float(len(KINDS) - 1))
    field = xr.DataArray(values * shown.factor, dims=("y", "x"), coords={"y": record.y, "x": record.x})
    limits = limits or place.limits or colour_limits(field.values, place.signed, place.log)
    figure, [[ax]] = map_panels(field, 1, width=7.0)
    moment = AVERAGES[place.averaged] if place.averaged else f"t = {record.time[place.step]:.3f} s"
    label = shown.long_name + shown.in_unit
    norm = None
    if place.log:
        field, norm = abs(field), LogNorm(limits[0] if limits[0] > 0 else 1e-4 * limits[1], limits[1])
    title = f"{record.experiment}, {moment}"
    draw_map(ax, field, label, cmap=place.colour_map, scale=limits, title=title, norm=norm)
    if place.overlay != "nothing" and place.averaged != "rms" and {"u", "v"} <= set(fields):
        u, v, x, y = fields["u"], fields["v"], record.x, record.y
        if place.overlay == "streamlines":
            xs, ys = streamlines(u, v, x, y)
        else:
            xs, ys, _ = arrows(u, v, x, y, fastest or top_speed(u, v))
        ax.plot(xs, ys, color="black", linewidth=0.7)
    return figure


def map_of(record: CubeRecord, place: Place) -> dict[str, NDArray[np.float32]]:
    """What the map shows of the displayed variable and of u and v, (ny, nx), in stored units."""
    request = request_of(record, place)
    if not place.averaged:
        return {name: record.field(name, place.step) for name in request.names}
    index = index_of(record, place)
    if index is None:
        raise StoreError("a phase average needs the period of the waves: enter it beside the average")
    return {name: found[index] for name, found in averages(record, request).items()}


def picture(record: CubeRecord, place: Place, kind: str) -> bytes:
    """The map as a PNG or SVG file."""
    return file_of(draw(record, place), kind, dpi=160)


def movie(record: CubeRecord, place: Place, encode: Callable[[Pictures, float], bytes], frames: int) -> bytes:
    """The playback from a step on."""
    place = replace(place, average="")
    stop = min(place.step + min(frames, MAX_MOVIE_FRAMES), record.layout.steps)
    if stop - place.step < 2:
        raise StoreError("a movie needs at least two steps: begin it earlier")
    return encode(_pictures(record, place, stop), min(record.frame_rate, MAX_FRAMES_PER_S))


def _pictures(record: CubeRecord, place: Place, stop: int) -> Pictures:
    """Pictures of one size and one colour scale."""
    shown = display(place.show)
    samples = np.unique(np.linspace(place.step, stop - 1, 5).astype(int))
    values = np.array([record.field(place.show, k) for k in samples]) * shown.factor
    limits = place.limits or colour_limits(values, place.signed, place.log)
    fastest = top_speed(record.field("u", place.step), record.field("v", place.step))
    for step in range(place.step, stop):
        figure = draw(record, replace(place, step=step), limits, fastest)
        figure.set_dpi(110)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        rgb = np.asarray(canvas.buffer_rgba())[..., :3]
        height, width = (n - n % 2 for n in rgb.shape[:2])  # encoders need even numbers
        yield np.ascontiguousarray(rgb[:height, :width])


def mp4(pictures: Pictures, rate: float) -> bytes:
    """Pictures as an MP4 file, so many per second."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "play.mp4"
        first = next(pictures)
        code = cv2.VideoWriter.fourcc(*"mp4v")
        writer = cv2.VideoWriter(str(path), code, rate, (first.shape[1], first.shape[0]))
        if not writer.isOpened():
            raise StoreError("this installation of OpenCV cannot write MP4: save a GIF instead")
        writer.write(first[..., ::-1])
        for rgb in pictures:
            writer.write(rgb[..., ::-1])
        writer.release()
        return path.read_bytes()


def gif(pictures: Pictures, rate: float) -> bytes:
    """Pictures as a GIF file, so many per second."""
    from PIL import Image  # a dependency of matplotlib

    frames = [Image.fromarray(rgb).convert("P", palette=Image.Palette.ADAPTIVE) for rgb in pictures]
    out = io.BytesIO()
    duration = max(20, round(1000 / rate))  # ms
    frames[0].save(out, format="GIF", save_all=True, append_images=frames[1:], duration=duration, loop=0)
    return out.getvalue()


def node_series(record: CubeRecord, place: Place) -> xr.Dataset:
    """Every variable at the picked node, (time,), from the preview; the derived ones from the cube."""
    if place.node is None:
        raise StoreError("no node is picked: click one on the map")
    preview = record.preview
    j, i = nearest(preview.y, place.node[1]), nearest(preview.x, place.node[0])
    there = record.ledger != 0
    variables = {
        name: ("time", np.where(there, preview.series(name, j, i), np.nan)) for name in preview.thin.names
    }
    row, column = nearest(record.y, preview.y[j]), nearest(record.x, preview.x[i])
    variables |= {name: ("time", series) for name, series in derived_series(record, row, column).items()}
    return _labelled(variables, {"time": record.time, "x": preview.x[i], "y": preview.y[j]}, record)


def line_table(record: CubeRecord, place: Place) -> xr.Dataset:
    """The displayed variable along the picked line at the displayed step, (distance,)."""
    if place.line is None:
        raise StoreError("no line is drawn: choose `line` for dragging")
    spacing = float(np.mean(np.diff(record.x)))
    distance, x, y = line_points(place.line[:2], place.line[2:], spacing)
    values = interpolate(record.field(place.show, place.step), record.x, record.y, x, y)
    variables = {"x": ("distance", x), "y": ("distance", y), place.show: ("distance", values)}
    return xr.Dataset(variables, coords={"distance": distance})


def step_fields(record: CubeRecord, place: Place) -> xr.Dataset:
    """Every variable at the displayed step, (y, x)."""
    variables = {name: (("y", "x"), record.field(name, place.step)) for name in record.names}
    coords = {"time": float(record.time[place.step]), "y": record.y, "x": record.x}
    return _labelled(variables, coords, record)


def area_fields(record: CubeRecord, place: Place) -> xr.Dataset:
    """Every variable in the picked rectangle at all steps, (time, y, x), from the preview."""
    if place.area is None:
        raise StoreError("no rectangle is drawn: choose `rectangle` for dragging")
    preview = record.preview
    x0, y0, x1, y1 = place.area
    rows, columns = span(preview.y, y0, y1), span(preview.x, x0, x1)
    variables = {}
    for name in preview.thin.names:
        values = decode(preview.stored(name)[rows, columns], preview.scale(name))
        values[..., record.ledger == 0] = np.nan
        variables[name] = (CUBE_DIMS, np.moveaxis(values, -1, 0))
    coords = {"time": record.time, "y": preview.y[rows], "x": preview.x[columns]}
    return _labelled(variables, coords, record)


def _labelled(
    variables: Mapping[str, tuple[object, NDArray[np.floating]]],
    coords: Mapping[str, object],
    record: CubeRecord,
) -> xr.Dataset:
    out = record.annotated(xr.Dataset(variables, coords=coords))
    for variable in out.variables.values():
        variable.attrs.pop("ancillary_variables", None)
    out.attrs = {"experiment": record.experiment, "cube": record.path.name, "frame_rate": record.frame_rate}
    return out


def as_netcdf(dataset: xr.Dataset) -> bytes:
    """A dataset as a NetCDF-4 file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.nc"
        dataset.to_netcdf(path, engine="h5netcdf")
        return path.read_bytes()


def as_csv(dataset: xr.Dataset) -> bytes:
    """A dataset of one dimension as a table with units in its first line."""
    frame = dataset.drop_vars("path_frames", errors="ignore").to_dataframe()
    units = [dataset[name].attrs.get("units", "") for name in frame.columns]
    frame.columns = [f"{n} ({u})" if u not in ("", "1") else str(n) for n, u in zip(frame.columns, units)]
    return bytes(frame.to_csv().encode())


# name: content type, function of the cube, the place and the number of frames of a movie
FILES: dict[str, tuple[str, Callable[[CubeRecord, Place, int], bytes]]] = {
    "map.png": ("image/png", lambda r, p, n: picture(r, p, "png")),
    "map.svg": ("image/svg+xml", lambda r, p, n: picture(r, p, "svg")),
    "play.mp4": ("video/mp4", lambda r, p, n: movie(r, p, mp4, n)),
    "play.gif": ("image/gif", lambda r, p, n: movie(r, p, gif, n)),
    "node.csv": ("text/csv", lambda r, p, n: as_csv(node_series(r, p))),
    "node.nc": ("application/x-netcdf", lambda r, p, n: as_netcdf(node_series(r, p))),
    "line.csv": ("text/csv", lambda r, p, n: as_csv(line_table(r, p))),
    "step.nc": ("application/x-netcdf", lambda r, p, n: as_netcdf(step_fields(r, p))),
    "area.nc": ("application/x-netcdf", lambda r, p, n: as_netcdf(area_fields(r, p))),
}
