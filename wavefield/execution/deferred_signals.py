"""Putting off Ctrl-C and the other signals that stop a run."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Put off the signals that stop a run until a call is over; a second one acts at once.

    A call of distributed that is interrupted before it began prints a traceback from another thread, and
    Ctrl-C inside an import may be lost.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    names = [name for name in ("SIGINT", "SIGTERM", "SIGUSR1", "SIGALRM") if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in (getattr(signal, name) for name in names)}
    received: list[int] = []

    def later(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            deliver(number, frame)

    def deliver(number: int, frame: FrameType | None) -> None:
        handler = before[signal.Signals(number)]
        if callable(handler):
            handler(number, frame)

    ours = [number for number, handler in before.items() if callable(handler)]
    for number in ours:
        signal.signal(number, later)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, before[number])
    if received:
        deliver(received[0], None)
