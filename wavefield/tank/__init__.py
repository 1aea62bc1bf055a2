"""Simulated experiments with exact truth: a sea, beads on it, cameras above it, targets, probes."""

from wavefield.tank.basin import Basin
from wavefield.tank.beads import carry
from wavefield.tank.rigs import paper_rig
from wavefield.tank.scene import Scene
from wavefield.tank.sea import Sea, intrinsic_frequency
from wavefield.tank.tank import Tank, render

__all__ = ["Basin", "Scene", "Sea", "Tank", "carry", "intrinsic_frequency", "paper_rig", "render"]
