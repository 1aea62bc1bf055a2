"""From cubes to spectra, nonlinear term and coherence: estimators with confidence intervals.

Input is a cube z, z_t, u, v, w (time, y, x), metres and seconds. Functions take and give labelled xarray
objects; lazy input gives lazy results, reduced in one pass over Welch segments.
"""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
