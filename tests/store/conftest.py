"""Fixtures of the small tank and its cube."""

from cube_fixtures import knocked, learned_once, measured, own_tank, reference, tank

__all__ = ["knocked", "learned_once", "measured", "own_tank", "reference", "tank"]
