"""A cube for ParaView: the surface of every step with its fields, and the list of steps."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import xarray as xr
from numpy.typing import NDArray

_TYPES = {"float32": "Float32", "float64": "Float64", "uint8": "UInt8", "uint16": "UInt16"}
_HIDDEN = np.uint8(2)  # vtkDataSetAttributes::HIDDENPOINT: nodes without an elevation are not drawn
_HEAD = '<?xml version="1.0"?>\n<!-- written by wavefield -->\n'
_VELOCITY = ("u", "v", "w")


def write_paraview(steps: Iterator[xr.Dataset], draft: Path, folder: str) -> str:
    """Write every step as a structured grid (.vts); returns the text of the series of them (.pvd).
    Points are (x, y, z), ``velocity`` is (u, v, w); nodes without z are hidden (``vtkGhostType``).
    """
    draft.mkdir()
    lines: list[str] = []
    for step in steps:
        x, y = np.meshgrid(np.asarray(step.x), np.asarray(step.y))
        name = f"step_{len(lines):05d}.vts"
        (draft / name).write_bytes(structured_grid(x, y, step))
        place = quoteattr(f"{folder}/{name}")
        lines.append(f'<DataSet timestep="{float(step.time):.9g}" part="0" file={place}/>')
    head = f'{_HEAD}<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">'
    body = "\n".join(lines)
    return f"{head}\n<Collection>\n{body}\n</Collection>\n</VTKFile>\n"


def structured_grid(x: NDArray[Any], y: NDArray[Any], step: xr.Dataset) -> bytes:
    """One step (y, x) as the bytes of a .vts file; x and y are (ny, nx), metres."""
    arrays, data, at = [], [], 0
    for name, values in points_and_fields(x, y, step).items():
        parts = values.shape[2] if values.ndim == 3 else 1
        arrays.append(
            f'<DataArray type="{_TYPES[str(values.dtype)]}" Name="{name}" NumberOfComponents="{parts}" '
            f'format="appended" offset="{at}"/>'
        )
        data.append(_compressed(values))
        at += len(data[-1])
    ny, nx = x.shape
    extent = f"0 {nx - 1} 0 {ny - 1} 0 0"
    text = (
        f'{_HEAD}<VTKFile type="StructuredGrid" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64" compressor="vtkZLibDataCompressor">\n'
        f'<StructuredGrid WholeExtent="{extent}">\n<Piece Extent="{extent}">\n'
        f'<Points>\n{arrays[0]}\n</Points>\n<PointData Scalars="z" Vectors="velocity">\n'
        + "\n".join(arrays[1:])
        + '\n</PointData>\n</Piece>\n</StructuredGrid>\n<AppendedData encoding="raw">\n_'
    )
    return text.encode() + b"".join(data) + b"\n</AppendedData>\n</VTKFile>\n"


def points_and_fields(x: NDArray[Any], y: NDArray[Any], step: xr.Dataset) -> dict[str, NDArray[Any]]:
    """What ParaView is given of a step (y, x), as arrays (ny, nx): ``Points`` on the surface, m, first."""
    z = np.asarray(step.z, np.float32)
    known = np.isfinite(z)
    out: dict[str, NDArray[Any]] = {"Points": np.stack([x, y, np.where(known, z, 0)], -1).astype(np.float32)}
    for name, field in step.data_vars.items():
        if field.dims == ("y", "x") and name not in _VELOCITY:
            out[str(name)] = np.asarray(field)
    if all(name in step for name in _VELOCITY):
        out["velocity"] = np.stack([np.asarray(step[name], np.float32) for name in _VELOCITY], -1)
    out["vtkGhostType"] = np.where(known, np.uint8(0), _HIDDEN)
    return out


def _compressed(values: NDArray[Any]) -> bytes:
    """One compressed block: number of blocks, size of each, of an incomplete last one, compressed size."""
    raw = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    packed = zlib.compress(raw, 4)
    return struct.pack("<4Q", 1, len(raw), 0, len(packed)) + packed
