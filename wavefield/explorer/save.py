"""What is seen, as files: pictures, movies, tables. Pure functions of the cube and the place."""

import io
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from wavefield.errors import StoreError
from wavefield.explorer.cube_record import CubeRecord
from wavefield.explorer.derived_series import derived_series
from wavefield.explorer.map_fields import arrows, colour_limits, colour_map, shown_as
from wavefield.explorer.place import Place
from wavefield.explorer.selections import interpolate, line_points, nearest, span
from wavefield.figures.quality import KINDS, quality_kind
from wavefield.figures.style import draw_map, limit, map_panels
from wavefield.variables import CUBE_DIMS, annotate

_FASTEST = 25.0  # pictures a second, at most
_MOST_FRAMES = 2000


def draw(
    record: CubeRecord, place: Place, limits: tuple[float, float] | None = None, fastest: float = 0.0
) -> Any:
    """The map as a figure.

    With limits (float, float); fastest, m/s.
    """
    shown = shown_as(place.show, record.units(place.show))
    values = record.field(place.show, place.step)
    if place.show == "quality":
        kinds = quality_kind(values)
        values = np.where(kinds < len(KINDS), kinds, np.nan).astype(np.float32)
        limits = (0.0, float(len(KINDS) - 1))
    field = xr.DataArray(values * shown.factor, dims=("y", "x"), coords={"y": record.y, "x": record.x})
    limits = limits or place.limits or colour_limits(field.values, place.show)
    figure, axes = map_panels(field, 1, width=7.0)
    ax = axes[0, 0]
    label = f"{record.long_name(place.show)}{shown.suffix}"
    title = f"{record.experiment}, t = {record.time[place.step]:.3f} s"
    draw_map(ax, field, label, cmap=colour_map(place.show), scale=limits, title=title)
    if place.arrows:
        u, v = record.field("u", place.step), record.field("v", place.step)
        speed = fastest or (limit(np.hypot(u, v), 98) if np.isfinite(u).any() else 0.0)
        ax.plot(*arrows(u, v, record.x, record.y, speed)[:2], color="black", linewidth=0.7)
    return figure


def picture(record: CubeRecord, place: Place, kind: str) -> bytes:
    """The map as a file."""
    out = io.BytesIO()
    draw(record, place).savefig(out, format=kind, dpi=160)
    return out.getvalue()


def movie(record: CubeRecord, place: Place, kind: str, frames: int) -> bytes:
    """The play from a step on."""
    stop = min(place.step + min(frames, _MOST_FRAMES), record.layout.steps)
    if stop - place.step < 2:
        raise StoreError("a movie needs two steps at least: begin it earlier")
    rate = min(record.frame_rate, _FASTEST)
    return (_mp4 if kind == "mp4" else _gif)(_pictures(record, place, stop), rate)


def _pictures(record: CubeRecord, place: Place, stop: int) -> Iterator[NDArray[np.uint8]]:
    """Pictures (row, column, 3), red first, of one size and one colour scale."""
    from dataclasses import replace

    sample = [
        record.field(place.show, k) for k in np.unique(np.linspace(place.step, stop - 1, 5).astype(int))
    ]
    factor = shown_as(place.show, record.units(place.show)).factor
    limits = place.limits or colour_limits(np.array(sample) * factor, place.show)
    u, v = record.field("u", place.step), record.field("v", place.step)
    fastest = limit(np.hypot(u, v), 98) if np.isfinite(u).any() else 0.0
    for step in range(place.step, stop):
        figure = draw(record, replace(place, step=step), limits, fastest)
        figure.set_dpi(110)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        rgb = np.asarray(canvas.buffer_rgba())[..., :3]
        yield np.ascontiguousarray(
            rgb[: rgb.shape[0] // 2 * 2, : rgb.shape[1] // 2 * 2]
        )  # encoders want even


def _mp4(pictures: Iterator[NDArray[np.uint8]], rate: float) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "play.mp4"
        writer: Any = None
        for rgb in pictures:
            if writer is None:
                code = cv2.VideoWriter.fourcc(*"mp4v")
                writer = cv2.VideoWriter(str(path), code, rate, (rgb.shape[1], rgb.shape[0]))
                if not writer.isOpened():
                    raise StoreError("this installation of OpenCV cannot write MP4: save a GIF instead")
            writer.write(rgb[..., ::-1])
        writer.release()
        return path.read_bytes()


def _gif(pictures: Iterator[NDArray[np.uint8]], rate: float) -> bytes:
    from PIL import Image  # matplotlib's own

    frames = [Image.fromarray(rgb).convert("P", palette=Image.Palette.ADAPTIVE) for rgb in pictures]
    out = io.BytesIO()
    frames[0].save(
        out,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=max(20, round(1000 / rate)),
        loop=0,
    )
    return out.getvalue()


def node_series(record: CubeRecord, place: Place) -> xr.Dataset:
    """Every variable at the picked node, from the preview; what is derived from them, from the cube.

    Returns (time,).
    """
    if place.node is None:
        raise StoreError("no node is picked: click one on the map")
    preview = record.preview
    j, i = nearest(preview.y, place.node[1]), nearest(preview.x, place.node[0])
    variables = {name: ("time", preview.series(name, j, i)) for name in preview.thin.names}
    row, column = nearest(record.y, preview.y[j]), nearest(record.x, preview.x[i])
    variables |= {name: ("time", series) for name, series in derived_series(record, row, column).items()}
    out = xr.Dataset(variables, coords={"time": record.time, "x": preview.x[i], "y": preview.y[j]})
    return _labelled(out, record)


def line_table(record: CubeRecord, place: Place) -> xr.Dataset:
    """The shown variable along the picked line, now.

    Returns (distance,).
    """
    if place.line is None:
        raise StoreError("no line is drawn: choose `line` for dragging")
    spacing = float(np.mean(np.diff(record.x)))
    distance, x, y = line_points(place.line[:2], place.line[2:], spacing)
    values = interpolate(record.field(place.show, place.step), record.x, record.y, x, y)
    return xr.Dataset(
        {"x": ("distance", x), "y": ("distance", y), place.show: ("distance", values)},
        coords={"distance": distance},
    )


def step_fields(record: CubeRecord, place: Place) -> xr.Dataset:
    """Every variable at the shown step.

    Returns (y, x).
    """
    variables = {name: (("y", "x"), record.field(name, place.step)) for name in record.names}
    coordinates = {"time": float(record.time[place.step]), "y": record.y, "x": record.x}
    return _labelled(xr.Dataset(variables, coords=coordinates), record)


def area_fields(record: CubeRecord, place: Place) -> xr.Dataset:
    """Every variable in the picked rectangle at all steps, from the preview.

    Returns (time, y, x).
    """
    from wavefield.explorer.selections import decode

    if place.area is None:
        raise StoreError("no rectangle is drawn: choose `rectangle` for dragging")
    preview = record.preview
    x0, y0, x1, y1 = place.area
    rows, columns = span(preview.y, y0, y1), span(preview.x, x0, x1)
    variables = {}
    for name in preview.thin.names:
        values = decode(preview.stored(name)[rows, columns], preview.scale(name))
        variables[name] = (CUBE_DIMS, np.moveaxis(values, -1, 0))
    coordinates = {"time": record.time, "y": preview.y[rows], "x": preview.x[columns]}
    return _labelled(xr.Dataset(variables, coords=coordinates), record)


def _labelled(dataset: xr.Dataset, record: CubeRecord) -> xr.Dataset:
    out: xr.Dataset = annotate(dataset.assign_coords(record.paths))
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
    """A dataset of one dimension as a table, its units in the first line."""
    frame = dataset.drop_vars("path_frames", errors="ignore").to_dataframe()
    units = {str(name): dataset[name].attrs.get("units", "") for name in frame.columns}
    frame.columns = [
        f"{name} ({units[name]})" if units[name] not in ("", "1") else name for name in frame.columns
    ]
    return bytes(frame.to_csv().encode())


_Maker = Callable[[CubeRecord, Place, int], bytes]

FILES: dict[str, tuple[str, _Maker]] = {
    "map.png": ("image/png", lambda r, p, n: picture(r, p, "png")),
    "map.svg": ("image/svg+xml", lambda r, p, n: picture(r, p, "svg")),
    "play.mp4": ("video/mp4", lambda r, p, n: movie(r, p, "mp4", n)),
    "play.gif": ("image/gif", lambda r, p, n: movie(r, p, "gif", n)),
    "node.csv": ("text/csv", lambda r, p, n: as_csv(node_series(r, p))),
    "node.nc": ("application/x-netcdf", lambda r, p, n: as_netcdf(node_series(r, p))),
    "line.csv": ("text/csv", lambda r, p, n: as_csv(line_table(r, p))),
    "step.nc": ("application/x-netcdf", lambda r, p, n: as_netcdf(step_fields(r, p))),
    "area.nc": ("application/x-netcdf", lambda r, p, n: as_netcdf(area_fields(r, p))),
}
