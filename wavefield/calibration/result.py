"""What comes of a calibration: a rig, and how far it can be trusted."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from wavefield.calibration.bundle import Fit
from wavefield.calibration.derived_uncertainty import Derived
from wavefield.calibration.model_choice import Choice
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
        Why not, and what to photograph again.
    notes : tuple of str
        What was left out, and what a person should know.
    model : str
        The camera model, a name of `wavefield.calibration.model_choice.MODELS`.
    models : tuple of Choice
        The models that were compared.
    observations : Observations, optional
        What the fit used.
    fit : Fit, optional
        The joint fit.
    derived : Derived, optional
        What the uncertainty of the parameters means for pixels and for z.
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
    derived: Derived | None = None
    left_out: Mapping[str, int] = field(default_factory=dict)
    target_std: float = 0.0
    reference: str = ""

    @property
    def node_offsets(self) -> Array:
        """How far each of ``observations.nodes`` was found from its place on the target, (N, 3), metres."""
        return np.zeros((0, 3)) if self.fit is None else self.fit.geometry.offset
