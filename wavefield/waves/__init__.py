"""Wave spectra, the nonlinear term and coherence of a cube, with confidence intervals.

A cube holds the elevation z, its rate of rise z_t and the velocity u, v, w over (time, y, x), in metres and
seconds. The functions take and return labelled xarray objects. They read cubes on disk in pieces, so memory
stays bounded however long the record is.
"""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
