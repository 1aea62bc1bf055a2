"""Displacement of image A to image B on a lattice of blocks, from arrays alone."""

from wavefield.matching.learned_spectrum import first_prior, refined_prior, shrinkage
from wavefield.matching.map_field import Modes, edge_field
from wavefield.matching.map_variance import PosteriorVariance
from wavefield.matching.noise import (
    noise_factor_near_holes,
    noise_of_scores,
    trust_in_scores,
)
from wavefield.matching.prepared import PreparedImage, prepare
from wavefield.matching.pyramid import match, reevaluate, scores_at
from wavefield.matching.settings import Displacement, Evaluation, MatchSettings, Reason
from wavefield.matching.spectrum import Prior, displacement_area, footprint, transfer_function

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
