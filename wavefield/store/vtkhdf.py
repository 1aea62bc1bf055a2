"""A cube for ParaView in one file: VTKHDF, version 2.0, an unstructured grid that changes with time."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from wavefield.store.export_paraview import points_and_fields

_QUAD = 9  # VTK_QUAD
_CHUNK = 1 << 14  # values of a list whose length is not known in advance
_LISTS = {
    "NumberOfPoints": "i8",
    "NumberOfCells": "i8",
    "NumberOfConnectivityIds": "i8",
    "Connectivity": "i8",
    "Offsets": "i8",
    "Types": "u1",
}
_OFFSETS = ("PartOffsets", "CellOffsets", "ConnectivityIdOffsets")


def write_vtkhdf(cube: xr.Dataset, steps: Iterator[xr.Dataset], path: Path) -> None:
    """Write a cube as VTKHDF, step by step; points and fields as in `export_paraview`.
    Cells lie between four nodes that all have an elevation, stored again only where they change.
    """
    x, y = np.meshgrid(np.asarray(cube.x), np.asarray(cube.y))
    corners = _corners(*x.shape)
    count = cube.sizes["time"]
    with h5py.File(path, "w") as file:
        file.attrs["written_by_wavefield"] = 1
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 0])
        kind = b"UnstructuredGrid"
        root.attrs.create("Type", kind, dtype=h5py.string_dtype("ascii", len(kind)))
        for name, dtype in _LISTS.items():
            root.create_dataset(
                name, (0,), dtype, maxshape=(None,), chunks=(_CHUNK,), compression=4, shuffle=True
            )
        places = root.create_group("Steps")
        places.attrs["NSteps"] = count
        places["Values"] = np.asarray(cube.time, np.float64)
        places["NumberOfParts"] = np.ones(count, np.int64)
        for name in _OFFSETS:
            places[name] = np.zeros(count if name == "PartOffsets" else (count, 1), np.int64)
        before = None
        for at, step in enumerate(steps):
            arrays = points_and_fields(x, y, step)
            shown = (arrays["vtkGhostType"].ravel() == 0)[corners].all(axis=1)
            if before is None or not np.array_equal(shown, before):
                starts = _add_cells(root, corners[shown], x.size)
                before = shown
            for name, start in zip(_OFFSETS, starts):
                places[name][at] = start
            _write_step(root, at, count, "Points", "PointOffsets", arrays.pop("Points"))
            for name, values in arrays.items():
                _write_step(root, at, count, f"PointData/{name}", f"PointDataOffsets/{name}", values)


def _add_cells(root: h5py.Group, corners: NDArray[np.int64], points: int) -> tuple[int, int, int]:
    """Append the cells of a step; returns which they are, by `_OFFSETS`."""
    starts = len(root["NumberOfCells"]), len(root["Types"]), len(root["Connectivity"])
    added: dict[str, list[int] | NDArray[Any]] = {
        "NumberOfPoints": [points],
        "NumberOfCells": [len(corners)],
        "NumberOfConnectivityIds": [corners.size],
        "Connectivity": corners.ravel(),
        "Offsets": 4 * np.arange(len(corners) + 1),
        "Types": np.full(len(corners), _QUAD),
    }
    for name, values in added.items():
        data = root[name]
        data.resize(len(data) + len(values), axis=0)
        data[len(data) - len(values) :] = values
    return starts


def _write_step(root: h5py.Group, at: int, count: int, name: str, offsets: str, values: NDArray[Any]) -> None:
    """A step of what has a value at every node; the first one lays out all."""
    flat = values.reshape(-1, *values.shape[2:])
    each = len(flat)
    if name not in root:
        shape = (count * each, *flat.shape[1:])
        root.create_dataset(name, shape, flat.dtype, chunks=flat.shape, compression=4, shuffle=True)
        root[f"Steps/{offsets}"] = each * np.arange(count)
    root[name][at * each : (at + 1) * each] = flat


def _corners(ny: int, nx: int) -> NDArray[np.int64]:
    """Numbers of the nodes around every cell, anticlockwise, (cells, 4)."""
    node = np.arange(ny * nx).reshape(ny, nx)
    around = (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1])
    return np.stack([one.ravel() for one in around], axis=-1)
