"""Where a patch of one image went in another: displacements on a lattice of blocks, from arrays alone."""

from wavefield.matching.correlate import correlate
from wavefield.matching.displacement import Displacement, Reason
from wavefield.matching.gauss_newton import match
from wavefield.matching.prepared import Prepared, prepare
from wavefield.matching.settings import Settings
from wavefield.matching.transfer import footprint, restoring, transfer_function, transfer_kernel
from wavefield.matching.uncertainty import std_from_influence

__all__ = [
    "Displacement",
    "Prepared",
    "Reason",
    "Settings",
    "correlate",
    "footprint",
    "match",
    "prepare",
    "restoring",
    "std_from_influence",
    "transfer_function",
    "transfer_kernel",
]
