"""Wave spectra, statistics, kinematics and coherence of a water surface, with confidence intervals.

A cube is a Dataset with the elevation z (m), its rate of rise z_t at a fixed place and the velocity u, v, w
of the water at the surface (m/s) over (time, y, x). The functions take and return labelled xarray objects.
They read cubes on disk in pieces, so memory stays bounded however long the cube is.
"""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
