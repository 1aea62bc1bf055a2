"""Where a patch of one image went in another: displacements on a lattice of blocks, from arrays alone."""

from wavefield.matching.correlate import correlate
from wavefield.matching.displacement import Displacement, Reason
from wavefield.matching.gauss_newton import match
from wavefield.matching.prepared import Prepared, prepare
from wavefield.matching.settings import Settings
from wavefield.matching.uncertainty import std_from_influence, transfer_kernel

__all__ = [
    "Displacement",
    "Prepared",
    "Reason",
    "Settings",
    "correlate",
    "match",
    "prepare",
    "std_from_influence",
    "transfer_kernel",
]
