"""A cube as a MATLAB file of version 7.3, which is HDF5 behind a header of MATLAB's own."""

import struct
from collections.abc import Iterator
from typing import BinaryIO

import h5py
import numpy as np
import xarray as xr

from wavefield.variables import CUBE_DIMS

_HEADER = 512  # bytes before the HDF5
_CLASS = {"float32": "single", "float64": "double"}  # numpy's types whose names differ


def write_matlab(cube: xr.Dataset, steps: Iterator[xr.Dataset], stream: BinaryIO) -> None:
    """Write a cube as a MAT-file of version 7.3, which `load` and `matfile` (a step at a time) read.
    Fields are (y, x, time) in MATLAB; ``units`` and ``long_name`` are structs of texts, ``recipe`` is JSON.
    """
    cube = cube.drop_vars([name for name, variable in cube.variables.items() if variable.dtype.kind in "UOT"])
    with h5py.File(stream, "w", userblock_size=_HEADER) as file:
        for name, variable in cube.variables.items():
            _lay_out(file, str(name), variable)
        fields = [str(name) for name, variable in cube.variables.items() if variable.dims == CUBE_DIMS]
        for k, step in enumerate(steps):
            for name in fields:
                file[name][k] = np.asarray(step[name]).T
        for key in ("units", "long_name"):
            _write_struct(file, key, {str(n): str(v.attrs.get(key, "")) for n, v in cube.variables.items()})
        for name, value in cube.attrs.items():
            if isinstance(value, str) and value:
                _write_text(file, name, value)
    stream.seek(0)
    text = b"MATLAB 7.3 MAT-file, written by wavefield, HDF5 schema 1.00 ."
    stream.write(text.ljust(116) + bytes(8) + struct.pack("<H", 0x0200) + b"IM")


def _lay_out(file: h5py.File, name: str, variable: xr.Variable) -> None:
    """A field without its values yet, or a vector; MATLAB reads dimensions in reverse."""
    if variable.dims == CUBE_DIMS:
        count, ny, nx = variable.shape
        data = file.create_dataset(
            name, (count, nx, ny), variable.dtype, chunks=(1, nx, ny), compression=4, shuffle=True
        )
    else:
        values = np.asarray(variable)
        data = file.create_dataset(name, data=values.T if values.ndim > 1 else values[None])
    kind = str(data.dtype)
    data.attrs["MATLAB_class"] = np.bytes_(_CLASS.get(kind, kind))


def _write_text(group: h5py.Group, name: str, text: str) -> None:
    codes = np.frombuffer(text.encode("utf-16-le"), "<u2")
    data = group.create_dataset(name, data=codes[:, None] if codes.size else np.zeros((2,), "u8"))
    data.attrs["MATLAB_class"] = np.bytes_("char")
    data.attrs["MATLAB_int_decode"] = np.int32(2)
    if not codes.size:
        data.attrs["MATLAB_empty"] = np.uint8(1)


def _write_struct(file: h5py.File, name: str, texts: dict[str, str]) -> None:
    group = file.create_group(name)
    group.attrs["MATLAB_class"] = np.bytes_("struct")
    for key, text in texts.items():
        _write_text(group, key, text)
