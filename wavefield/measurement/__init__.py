"""From frames to z, z_t, u, v, w with their standard uncertainties, at the nodes of one grid.

All functions take and return arrays; step.py shows one step from top to bottom. Terms, in addition to those
of `wavefield.matching`:

* node: point (x, y) of the output grid; a place is any other point on the water;
* apparent position: where the sight line of a camera through a point meets the plane z = 0;
* sight-line slope D: horizontal displacement of a sight line per unit of height; parallax dD = D_b - D_a;
* epipolar error: the part of a displacement between two cameras that no elevation explains (`eps_y`);
* reference: the camera that belongs to all pairs; its apparent positions are the coordinates of z's lattice;
* mid-time: half-way between the two frames of a step, to which all its results belong;
* chord: displacement of a particle from frame to frame, unlike its velocity at mid-time;
* rise: change of elevation per step; texture: a water surface seen without beads.
"""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
