# The public names and their modules: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.matching.prepared import PreparedImage, prepare
from wavefield.matching.pyramid import match
from wavefield.matching.settings import Displacement, MatchSettings, Reason
from wavefield.matching.spectrum import Prior

__all__ = ["Displacement", "MatchSettings", "PreparedImage", "Prior", "Reason", "match", "prepare"]
