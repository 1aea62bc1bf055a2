"""Simulated experiments with exact truth: a sea, beads on it, cameras above it, targets, probes."""

from wavefield.tank.basin import Basin
from wavefield.tank.beads import carry
from wavefield.tank.rigs import paper_rig
from wavefield.tank.scene import Scene
from wavefield.tank.sea import Sea
from wavefield.tank.tank import Tank, render
from wavefield.tank.truth import Truth, displacement, truth
from wavefield.tank.write_experiment import simulate

__all__ = [
    "Basin",
    "Scene",
    "Sea",
    "Tank",
    "Truth",
    "carry",
    "displacement",
    "paper_rig",
    "render",
    "simulate",
    "truth",
]
