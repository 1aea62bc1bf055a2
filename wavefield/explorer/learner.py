"""Learning beads, spectra and noise again while frames arrive, in parallel to the measurement."""

import logging
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavefield.errors import WavefieldError
from wavefield.measurement import GridGeometry, Model, learn

log = logging.getLogger("wavefield.follow")
_STEPS = 2  # the newest ones, that are learned from
_MIN_PAUSE_S = 5.0  # from one learning to the next
_PAUSE_PER_DURATION = 3.0  # of the learning, so that the measurement has the machine to itself

Frames = Mapping[str, NDArray[Any] | None]
Masks = Mapping[str, NDArray[np.bool_]]


class Learner:
    """What is learned of a record as it is now; `model` is None before the first frames."""

    def __init__(self, geometry: GridGeometry) -> None:
        self.geometry = geometry
        self.model: Model | None = None
        self._steps: deque[tuple[tuple[Frames, Frames], tuple[Masks, Masks]]] = deque(maxlen=_STEPS)
        self._next_s = 0.0
        self._thread: threading.Thread | None = None

    def add(self, frames: tuple[Frames, Frames], masks: tuple[Masks, Masks]) -> None:
        """Learn from both frames of a step: the first time at once, later in a thread of its own."""
        self._steps.append((frames, masks))
        if self.model is None:
            self._learn()
        elif time.monotonic() >= self._next_s and not (self._thread and self._thread.is_alive()):
            self._thread = threading.Thread(target=self._learn, daemon=True, name="learn")
            self._thread.start()

    def _learn(self) -> None:
        begun = time.monotonic()
        steps = list(self._steps)
        try:
            record = learn([frames for frames, _ in steps], self.geometry, [masks for _, masks in steps])
            if record is not None:
                self.model = Model(self.geometry, record)
        except (WavefieldError, ValueError) as error:  # the model stays
            log.warning("nothing was learned from these frames: %s", error)
        except RuntimeError as error:
            if not str(error).startswith("cannot schedule"):  # the program ends, and its pools before it
                raise
        pause = max(_MIN_PAUSE_S, _PAUSE_PER_DURATION * (time.monotonic() - begun))
        self._next_s = time.monotonic() + pause

    def wait(self) -> None:
        """Wait until the learning that goes on has ended."""
        if self._thread is not None:
            self._thread.join(20)
