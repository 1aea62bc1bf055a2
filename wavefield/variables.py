"""Every variable of every dataset: one table that gives attributes, validation and documentation.

Waves add their own rows (spectra, coherences) with `register`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import Any

import numpy as np

CUBE_DIMS = ("time", "y", "x")


class Quality(IntFlag):
    """Bits of the cube's ``quality``."""

    MEASURED = 1  # found by matching on its own
    FILLED = 2  # interpolated from its neighbours
    OUTSIDE = 4  # outside the field seen by the cameras
    REJECTED_CORRELATION = 8
    REJECTED_EPS = 16
    REJECTED_NEIGHBOURS = 32
    TWO_FRAME_MEAN = 64  # z at mid-time from two frames instead of four
    FEWER_CAMERAS = 128  # a camera's frame is missing: the others did the work


class FrameStatus(IntEnum):
    """Values of ``frame_status``: the ledger of a run."""

    NOT_STARTED = 0
    DONE = 1
    DONE_WITH_FAULTS = 2
    FAILED = 3


class FrameFault(IntEnum):
    """What is wrong with a frame."""

    NONE = 0
    MISSING = 1
    UNREADABLE = 2  # corrupt, truncated, or not an image
    WRONG_SIZE = 3  # other rows, columns or type than the rest
    BLANK = 4  # black, or all pixels equal


@dataclass(frozen=True)
class Variable:
    """One row of the table.

    Parameters
    ----------
    name : str
        Name in the dataset.
    dims : tuple of str
        Dimensions, in order.
    units : str
        CF units; "1" for pure numbers.
    long_name : str
        What it is, for axis labels.
    dtype : str
        Type in the store.
    standard_name : str, optional
        CF standard name.
    meaning : str, optional
        A sentence for the documentation.
    extra : mapping, optional
        Further attributes.
    """

    name: str
    dims: tuple[str, ...]
    units: str
    long_name: str
    dtype: str = "float32"
    standard_name: str = ""
    meaning: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes as written to a store."""
        out: dict[str, Any] = {"long_name": self.long_name, "units": self.units}
        if self.standard_name:
            out["standard_name"] = self.standard_name
        if self.meaning:
            out["comment"] = self.meaning
        return out | dict(self.extra)


TABLE: dict[str, Variable] = {}


def register(*rows: Variable) -> None:
    """Add rows to the table.

    Parameters
    ----------
    *rows : Variable
        New variables; a name may be given once only.
    """
    for row in rows:
        if row.name in TABLE and TABLE[row.name] != row:
            raise ValueError(f"variable {row.name!r} is already in the table")
        TABLE[row.name] = row


def _cube(name: str, units: str, long_name: str, **more: Any) -> Variable:
    return Variable(name, CUBE_DIMS, units, long_name, **more)


def _flags(enum: Any) -> dict[str, Any]:
    key = "flag_masks" if issubclass(enum, IntFlag) else "flag_values"
    return {
        key: [int(member) for member in enum],
        "flag_meanings": " ".join(member.name.lower() for member in enum),
    }


register(
    Variable("time", ("time",), "s", "time at mid-step", dtype="float64", extra={"axis": "T"}),
    Variable("x", ("x",), "m", "x", dtype="float64", extra={"axis": "X"}),
    Variable("y", ("y",), "m", "y", dtype="float64", extra={"axis": "Y"}),
    _cube(
        "z",
        "m",
        "surface elevation",
        standard_name="water_surface_height_above_reference_datum",
        meaning="at mid-time, from the four frames around it",
        extra={"ancillary_variables": "z_std quality"},
    ),
    _cube("z_t", "m s-1", "rate of rise of the surface", meaning="(z(t + dt) - z(t)) / dt at a fixed node"),
    _cube(
        "u",
        "m s-1",
        "velocity along x",
        standard_name="surface_sea_water_x_velocity",
        extra={"ancillary_variables": "u_std quality"},
    ),
    _cube(
        "v",
        "m s-1",
        "velocity along y",
        standard_name="surface_sea_water_y_velocity",
        extra={"ancillary_variables": "v_std quality"},
    ),
    _cube(
        "w",
        "m s-1",
        "vertical velocity",
        standard_name="upward_sea_water_velocity",
        extra={"ancillary_variables": "w_std quality"},
    ),
    _cube("eps_y", "m", "stereo mismatch across the line of sight"),
    _cube("eps_piv", "px", "misfit of the cameras' displacements"),
    _cube("z_std", "m", "standard uncertainty of z"),
    _cube("u_std", "m s-1", "standard uncertainty of u"),
    _cube("v_std", "m s-1", "standard uncertainty of v"),
    _cube("w_std", "m s-1", "standard uncertainty of w"),
    _cube("quality", "1", "how a value came about", dtype="uint8", extra=_flags(Quality)),
    Variable("frame_status", ("time",), "1", "ledger of the run", dtype="uint8", extra=_flags(FrameStatus)),
)

CUBE_FIELDS = tuple(name for name, row in TABLE.items() if row.dims == CUBE_DIMS)


def annotate(dataset: Any) -> Any:
    """Give every known variable of a dataset its attributes.

    Parameters
    ----------
    dataset : xarray.Dataset
        Any dataset of this package.

    Returns
    -------
    xarray.Dataset
        The same data; attributes already there are kept unless the table has them.
    """
    out = dataset.copy()
    for name in [*out.coords, *out.data_vars]:
        if name in TABLE:
            out[name].attrs.update(TABLE[name].attrs)
    return out


def validate(dataset: Any, *names: str) -> None:
    """Check that a dataset holds variables with the table's dimensions and a kindred type.

    Parameters
    ----------
    dataset : xarray.Dataset
        What a user or a store gives.
    *names : str
        Variables that must be there.

    Raises
    ------
    ValueError
        If one is missing, or has other dimensions or another kind of type.
    """
    for name in names:
        row = TABLE[name]
        if name not in dataset:
            raise ValueError(f"the dataset has no {name!r} ({row.long_name})")
        array = dataset[name]
        if array.dims != row.dims:
            raise ValueError(f"{name!r} has dimensions {array.dims}, expected {row.dims}")
        if np.dtype(array.dtype).kind != np.dtype(row.dtype).kind:
            raise ValueError(f"{name!r} has type {array.dtype}, expected {row.dtype}")
