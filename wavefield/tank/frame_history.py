"""States that follow from frame to frame, of which the latest are remembered."""

from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

REMEMBERED_FRAMES = 8  # before the latest one


class FrameHistory(Generic[T]):
    """The state at any frame, advanced from the last one before it; the first and the latest are remembered.
    `advance(state, frame)` gives the state of the frame after one.
    """

    def __init__(self, first: T, advance: Callable[[T, int], T]) -> None:
        self._states, self._advance = {0: first}, advance

    def __getitem__(self, frame: int) -> T:
        if frame not in self._states:
            last = max(number for number in self._states if number <= frame)
            for number in range(last, frame):
                self._states[number + 1] = self._advance(self._states[number], number)
                kept = {0, *range(number + 1 - REMEMBERED_FRAMES, number + 2)}
                self._states = {n: state for n, state in self._states.items() if n in kept}
        return self._states[frame]
