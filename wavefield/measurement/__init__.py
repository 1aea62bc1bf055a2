"""Measure z, z_t, u, v, w with standard uncertainties from frames, at the nodes of one grid.

All functions take and return arrays; step.py shows one step from top to bottom. Terms, in addition to those
of `wavefield.matching`:

* node: point (x, y) of the output grid; a place is any other point on the water;
* apparent position: where the sight line of a camera through a point meets the plane z = 0;
* sight-line slope D: horizontal displacement of a sight line per unit of height; parallax dD = D_b - D_a;
* epipolar error: the part of a displacement between two cameras that no elevation explains (`eps_y`);
* reference: the camera that belongs to all pairs; blocks of z are at regular apparent positions in it;
* mid-time: half-way between the two frames of a step; all results of the step are for this time;
* chord: displacement of a particle from frame to frame, unlike its velocity at mid-time;
* rise: change of elevation per step; texture: a water surface seen without beads;
* prior: learned spectrum of a field; it suppresses waves that are weaker than the noise (MAP estimate).
"""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
