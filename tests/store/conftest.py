"""Runs of this room learn from the same frames once."""

from cube_fixtures import learned_once

__all__ = ["learned_once"]
