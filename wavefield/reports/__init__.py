"""The report of a run: one HTML file that opens offline. `wf.report(cube)` writes it."""

from wavefield.lazy_names import lazy_names

__all__, __getattr__, __dir__ = lazy_names(__name__, __file__)
