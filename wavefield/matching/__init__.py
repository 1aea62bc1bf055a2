"""Where a patch of one image went in another: displacements on a lattice of blocks, from arrays alone."""

from wavefield.matching.displacement import Displacement, Reason
from wavefield.matching.edges import Slopes, edge_slopes
from wavefield.matching.gauss_newton import match, reevaluate, scores_at
from wavefield.matching.matching_gain import footprint, raised, transfer_function
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.noise import along_each, around_holes, noise_of_scores
from wavefield.matching.posterior import Modes
from wavefield.matching.posterior_variance import Spread
from wavefield.matching.prepared import PreparedImage, prepare
from wavefield.matching.prior import Prior, better_prior, first_prior, shrinkage

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
    "edge_slopes",
    "first_prior",
    "footprint",
    "match",
    "noise_of_scores",
    "prepare",
    "raised",
    "reevaluate",
    "scores_at",
    "shrinkage",
    "transfer_function",
]
