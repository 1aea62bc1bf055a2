"""Learning beads, spectra and noise anew while frames come, beside the measurement, not before it."""

import logging
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from wavefield.errors import WavefieldError
from wavefield.measurement import GridGeometry, Model, learn

log = logging.getLogger("wavefield.follow")
_SETS = 2  # of the newest, that are learned from
_LEAST = 5.0  # s from one learning to the next
_IDLE = 3.0  # times as long as it took, so that the measurement has the machine to itself

Frames = Mapping[str, NDArray[Any] | None]


class Learner:
    """What is learned of a record as it is now; `model` is None before the first frames."""

    def __init__(self, geometry: GridGeometry) -> None:
        self.geometry = geometry
        self.model: Model | None = None
        self._sets: deque[tuple[tuple[Frames, Frames], tuple[Any, Any]]] = deque(maxlen=_SETS)
        self._next = 0.0
        self._thread: threading.Thread | None = None

    def take(self, step: tuple[Frames, Frames], masks: tuple[Any, Any]) -> None:
        """Take in both frames of a step: the first at once, later ones in a thread of its own.

        With step (mapping, mapping); masks (mapping, mapping).
        """
        self._sets.append((step, masks))
        if self.model is None:
            self._learn()
        elif time.monotonic() >= self._next and not self._busy:
            self._thread = threading.Thread(target=self._learn, daemon=True, name="learn")
            self._thread.start()

    @property
    def _busy(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _learn(self) -> None:
        begun = time.monotonic()
        sets = list(self._sets)
        try:
            record = learn([step for step, _ in sets], self.geometry, [masks for _, masks in sets])
            if record is not None:
                self.model = Model(self.geometry, record)
        except (WavefieldError, ValueError) as error:  # what was known stays
            log.warning("these frames taught nothing: %s", error)
        except RuntimeError as error:
            if not str(error).startswith("cannot schedule"):  # the program ends, and its pools before it
                raise
        self._next = time.monotonic() + max(_LEAST, _IDLE * (time.monotonic() - begun))

    def wait(self) -> None:
        """Wait until what is being learned is known."""
        if self._thread is not None:
            self._thread.join(20)
