"""Displacement from image a to image b on a lattice of blocks, from arrays alone.

`prepare` an image, `match` two of them. The measurement goes on from there: it evaluates blocks again at a
displacement (pyramid.py), weighs them against a learned spectrum (spectrum.py, learned_spectrum.py,
map_field.py) and takes the variance of the result (noise.py, map_variance.py). Loops over pixels are in
kernels.py, loops over blocks in blocks.py.
"""

from wavefield.matching.prepared import PreparedImage, prepare
from wavefield.matching.pyramid import match
from wavefield.matching.settings import Displacement, MatchSettings, Reason
from wavefield.matching.spectrum import Prior

__all__ = ["Displacement", "MatchSettings", "PreparedImage", "Prior", "Reason", "match", "prepare"]
