"""Where a patch of one image went in another: displacements on a lattice of blocks, from arrays alone."""

from wavefield.matching.correlate import correlate
from wavefield.matching.displacement import Displacement, Reason
from wavefield.matching.edges import Slopes, edge_slopes
from wavefield.matching.gauss_newton import match, reevaluate, scores_at
from wavefield.matching.matching_gain import footprint, raised, restoring, transfer_function, transfer_kernel
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.noise import along_each, around_holes, noise_of_scores
from wavefield.matching.posterior import Modes
from wavefield.matching.posterior_variance import Spread
from wavefield.matching.prepared import PreparedImage, prepare
from wavefield.matching.prior import Prior, better_prior, first_prior, shrinkage
from wavefield.matching.uncertainty import std_from_influence

__all__ = [
    "Displacement",
    "MatchSettings",
    "Modes",
    "PreparedImage",
    "Prior",
    "Reason",
    "Slopes",
    "Spread",
    "along_each",
    "around_holes",
    "better_prior",
    "correlate",
    "edge_slopes",
    "first_prior",
    "footprint",
    "match",
    "noise_of_scores",
    "prepare",
    "raised",
    "reevaluate",
    "restoring",
    "scores_at",
    "shrinkage",
    "std_from_influence",
    "transfer_function",
    "transfer_kernel",
]
