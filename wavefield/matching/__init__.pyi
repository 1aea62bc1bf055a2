# The public names and their modules: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.matching.prepared import PreparedImage, prepare
from wavefield.matching.pyramid import match
from wavefield.matching.settings import Displacement, MatchSettings, Reason

__all__ = ["Displacement", "MatchSettings", "PreparedImage", "Reason", "match", "prepare"]
