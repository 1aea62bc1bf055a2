"""Every variable of every dataset: one table that gives attributes, checks and documentation."""

from wavefield.variables.codes import FrameFault, FrameStatus, Quality
from wavefield.variables.cube import (
    AROUND,
    CUBE_FIELDS,
    EXACT_SIX,
    INSTANTANEOUS,
    PATH_WEIGHTS,
    frames_of_path,
)
from wavefield.variables.spectra_table import (
    FIELD_TEXTS,
    FIELD_UNITS,
    K_UNITS,
    METHODS,
    OMEGA_UNITS,
    density_units,
)
from wavefield.variables.table import CUBE_DIMS, TABLE, Variable, annotate, find, register, rows_of, validate
from wavefield.variables.units import factor, product
from wavefield.variables.waves_table import GROUPS

__all__ = [
    "AROUND",
    "CUBE_DIMS",
    "CUBE_FIELDS",
    "EXACT_SIX",
    "FIELD_TEXTS",
    "FIELD_UNITS",
    "GROUPS",
    "INSTANTANEOUS",
    "K_UNITS",
    "METHODS",
    "OMEGA_UNITS",
    "PATH_WEIGHTS",
    "TABLE",
    "FrameFault",
    "FrameStatus",
    "Quality",
    "Variable",
    "annotate",
    "density_units",
    "factor",
    "find",
    "frames_of_path",
    "product",
    "register",
    "rows_of",
    "validate",
]
