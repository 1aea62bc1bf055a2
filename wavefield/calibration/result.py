"""Result of a calibration: a rig, and how far it can be trusted."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.calibration.model_choice import Choice, PredictedErrors
from wavefield.calibration.observations import Observations
from wavefield.rig import Rig
from wavefield.rig.lens import Array


@dataclass(frozen=True)
class Calibration:
    """A rig and how far it can be trusted.

    Parameters
    ----------
    rig : Rig
        The cameras; empty if none could be solved for.
    usable : bool
        Whether measurements may be made with it.
    problems : tuple of str
        Why not, and which target images to retake.
    notes : tuple of str
        What was left out, and other remarks.
    model : str
        The camera model, a name of `wavefield.calibration.model_choice.MODELS`.
    models : tuple of Choice
        The models that were compared.
    observations : Observations, optional
        The points that were fitted.
    fit : Fit, optional
        The joint fit.
    predicted : PredictedErrors, optional
        Uncertainty of pixels and of z that follows from that of the parameters.
    left_out : dict of str to int
        Points left out per view ("camera pose"), all of them where the view is.
    target_std : float
        Stated uncertainty of the target's nodes per axis, metres.
    reference : str
        The view that defines z = 0 and the axes.
    """

    rig: Rig
    usable: bool
    problems: tuple[str, ...]
    notes: tuple[str, ...] = ()
    model: str = ""
    models: tuple[Choice, ...] = ()
    observations: Observations | None = None
    fit: Fit | None = None
    predicted: PredictedErrors | None = None
    left_out: Mapping[str, int] = field(default_factory=dict)
    target_std: float = 0.0
    reference: str = ""

    @property
    def node_offsets(self) -> Array:
        """Offset of each of ``observations.nodes`` from its position on the target, (N, 3), metres."""
        return np.zeros((0, 3)) if self.fit is None else self.fit.geometry.offset
