"""The table of variables, from which attributes, checks and documentation follow; conversion of units."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from wavefield.errors import CubeError

_TOKEN = re.compile(r"^([A-Za-z_]+|%)(?:\^|\*\*)?(-?\d+)?$")
# factor and base unit of each accepted spelling
_KNOWN = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), (1.0, "m")),
    **{"cm": (1e-2, "m"), "mm": (1e-3, "m"), "um": (1e-6, "m"), "km": (1e3, "m")},
    **dict.fromkeys(("s", "sec", "second", "seconds"), (1.0, "s")),
    **{"ms": (1e-3, "s"), "min": (60.0, "s")},
    **dict.fromkeys(("pixel", "pixels", "px"), (1.0, "pixel")),
}


def _powers(unit: str) -> dict[str, int]:
    """Return the exponent of each unit in text such as "m s-1" or "cm/s"; ValueError if unreadable."""
    out: dict[str, int] = {}
    for token in unit.replace("/", " /").split():
        sign = -1 if token.startswith("/") else 1
        match = _TOKEN.match(token.lstrip("/"))
        if match:
            name = match.group(1)
            out[name] = out.get(name, 0) + sign * int(match.group(2) or 1)
        elif token != "1":
            raise ValueError(f"{unit!r} is no product of units")
    return out


def product(*factors: tuple[str, int]) -> str:
    """Return the unit of a product of pairs (unit, power), such as "m3 s-1 rad-2"; "1" for a pure number."""
    powers: dict[str, int] = {}
    for unit, power in factors:
        for name, exponent in _powers(unit).items():
            powers[name] = powers.get(name, 0) + exponent * power
    order = sorted(powers, key=lambda name: (name == "rad", [*powers].index(name)))
    out = [name if powers[name] == 1 else f"{name}{powers[name]}" for name in order if powers[name]]
    return " ".join(out) or "1"


def factor(given: str, requested: str) -> float | None:
    """Return the factor that converts from a given to a requested unit: 0.01 from "cm/s" to "m s-1".
    None if the units measure different quantities, or if one cannot be read."""
    scale = 1.0
    left: dict[str, int] = {}
    for unit, sign in ((given, 1), (requested, -1)):
        try:
            powers = _powers(unit)
        except ValueError:
            return None
        for name, power in powers.items():
            size, base = _KNOWN.get(name, (1.0, name))
            scale *= size ** (sign * power)
            left[base] = left.get(base, 0) + sign * power
    return None if any(left.values()) else scale


if TYPE_CHECKING:  # slow to import
    import xarray as xr

CUBE_DIMS = ("time", "y", "x")
_PIECE = 256  # steps per Dask chunk of an array on disk whose type or unit is converted


@dataclass(frozen=True)
class Variable:
    """One variable of a dataset: its name, dimensions, units, type and attributes."""

    name: str  # Name in the dataset
    dims: tuple[str, ...]  # Dimensions, in order; the usual ones if they differ between datasets
    units: str  # CF units; "1" for pure numbers, "" if they depend on another variable
    long_name: str  # What it is, for axis labels
    dtype: str = "float32"  # Type in the store
    standard_name: str = ""  # CF standard name
    meaning: str = ""  # A sentence for the documentation
    extra: Mapping[str, Any] = field(default_factory=dict)  # Further attributes
    group: str = ""  # Group of the wave store, or "frames"; empty if the name means the same everywhere
    family: str = ""  # Pattern with a star for names that the documentation describes in one line

    @property
    def key(self) -> str:
        """Key in the table: group/name, or the name alone."""
        return f"{self.group}/{self.name}" if self.group else self.name

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes of the variable in a store: long name, units, standard name, comment, and others."""
        out: dict[str, Any] = {"long_name": self.long_name}
        if self.units:
            out["units"] = self.units
        if self.standard_name:
            out["standard_name"] = self.standard_name
        if self.meaning:
            out["comment"] = self.meaning
        return out | dict(self.extra)

    def of(self, what: str, units: str) -> dict[str, Any]:
        """Return the attributes with " of `what`" appended to the long name, and with the given units."""
        return self.attrs | {"long_name": f"{self.long_name} of {what}", "units": units}


TABLE: dict[str, Variable] = {}


def register(*rows: Variable) -> None:
    """Add rows to the table of variables; ValueError if the table has a different row with the same key."""
    for row in rows:
        if TABLE.setdefault(row.key, row) != row:
            raise ValueError(f"variable {row.key!r} is already in the table")


def find(name: str, group: str = "") -> Variable | None:
    """Return the row of the table for the variable `name` of a group, or else for `name` without a group.
    None if the table has neither row."""
    return TABLE.get(f"{group}/{name}", TABLE.get(name))


def rows_of(group: str) -> Iterator[Variable]:
    """Yield the rows of a group in the order of the table."""
    return (row for row in TABLE.values() if row.group == group)


def annotate(dataset: "xr.Dataset", group: str = "") -> "xr.Dataset":
    """Return a copy of a dataset in which each variable has the attributes of its row in the table.
    Rows of `group` come before rows without a group; variables without a row keep their attributes."""
    out = dataset.copy()
    for name in [*out.coords, *out.data_vars]:
        row = find(str(name), group)
        if row is not None:
            out[name].attrs.update(row.attrs)
    return out


def _one(array: "xr.DataArray", row: Variable) -> Any:
    """Return an array with its dimensions in the order, and its values in the units, of its row in the table.
    CubeError if its dimensions, type or units do not fit."""
    if set(array.dims) != set(row.dims):
        raise CubeError(f"{row.name!r} has dimensions {array.dims}, expected {row.dims}")
    kind = np.dtype(row.dtype).kind
    if not (array.dtype.kind == kind or (kind == "f" and array.dtype.kind in "iu")):
        raise CubeError(f"{row.name!r} has type {array.dtype}, expected {row.dtype}")
    return _in_units(array.transpose(*row.dims), row)


def _in_units(array: "xr.DataArray", row: Variable) -> Any:
    given = array.attrs.get("units")
    if not row.units or given in (None, row.units):
        return array
    scale = factor(str(given), row.units)
    if scale is None:
        raise CubeError(f"{row.name!r} is in {given!r}, which is no {row.units!r}: convert it first")
    if scale == 1:
        return array
    return (_lazy(array) * scale).assign_attrs(array.attrs | {"units": row.units})


def _lazy(array: "xr.DataArray") -> Any:
    # an array on disk becomes a Dask array, which reads chunk by chunk
    return array if array.chunks is not None or array._in_memory else array.chunk({array.dims[0]: _PIECE})


def validate(dataset: "xr.Dataset", *names: str) -> "xr.Dataset":
    """Return the named variables of a dataset, with dimensions in the order and units of the table.
    Units are converted (cm to m), floating-point variables get a common type, and data on disk stay there.
    CubeError if a variable is absent, or if its dimensions, type or units do not fit."""
    out = {}
    for name in names:
        row = TABLE[name]
        if name not in dataset:
            raise CubeError(f"the dataset has no {name!r} ({row.long_name})")
        out[name] = _one(dataset[name], row)
    variables = [name for name in names if name not in dataset.coords]
    fields = [name for name in variables if np.dtype(TABLE[name].dtype).kind == "f"]
    if fields:
        common = np.result_type(*(out[name].dtype for name in fields), np.float32)
        for name in fields:
            if out[name].dtype != common:
                out[name] = _lazy(out[name]).astype(common)
    kept: xr.Dataset = dataset[variables].assign({name: out[name] for name in variables})
    axes = [name for name in CUBE_DIMS if name in kept.coords and kept[name].dtype.kind in "fiu"]
    return kept.assign_coords({name: _in_units(kept[name], TABLE[name]) for name in axes})
