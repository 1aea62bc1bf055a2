"""Simulated experiments with known truth: a sea, beads on it, cameras above it, targets and wave probes."""

from wavefield.tank.rigs import paper_rig
from wavefield.tank.scene import Scene
from wavefield.tank.sea import Sea
from wavefield.tank.tank import Tank
from wavefield.tank.truth import Truth
from wavefield.tank.write_experiment import simulate

__all__ = ["Scene", "Sea", "Tank", "Truth", "paper_rig", "simulate"]
