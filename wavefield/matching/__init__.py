"""Displacement of image A to image B on a lattice of blocks, from arrays alone."""

from wavefield.matching.displacement import Displacement, Evaluation, Reason
from wavefield.matching.edges import edge_field
from wavefield.matching.gauss_newton import match, reevaluate, scores_at
from wavefield.matching.matching_gain import displacement_area, footprint, transfer_function
from wavefield.matching.matching_settings import MatchSettings
from wavefield.matching.noise import (
    noise_factor_near_holes,
    noise_of_scores,
    trust_in_scores,
)
from wavefield.matching.posterior import Modes
from wavefield.matching.posterior_variance import PosteriorVariance
from wavefield.matching.prepared import PreparedImage, prepare
from wavefield.matching.prior import Prior
from wavefield.matching.spectrum import first_prior, refined_prior, shrinkage

__all__ = [
    "Displacement",
    "Evaluation",
    "MatchSettings",
    "Modes",
    "PosteriorVariance",
    "PreparedImage",
    "Prior",
    "Reason",
    "displacement_area",
    "edge_field",
    "first_prior",
    "footprint",
    "match",
    "noise_factor_near_holes",
    "noise_of_scores",
    "prepare",
    "reevaluate",
    "refined_prior",
    "scores_at",
    "shrinkage",
    "transfer_function",
    "trust_in_scores",
]
