"""Signals that stop a run: in order, or a little later."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


def signal_numbers(*names: str) -> list[int]:
    """Numbers of the signals among these that this system has."""
    return [getattr(signal, name) for name in names if hasattr(signal, name)]


class Stopped(KeyboardInterrupt):
    """A signal other than Ctrl-C, or the time limit."""


def stopped_by(stop: KeyboardInterrupt) -> str:
    """How a sentence on a stopped run begins."""
    return f"stopped by {stop}" if isinstance(stop, Stopped) else "stopped"


@contextmanager
def stop_signals(time_limit: float | None = None) -> Iterator[None]:
    """Let SIGTERM, SIGUSR1 (Slurm's warning) and a time limit stop a run as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: object) -> None:
        name = signal.Signals(number).name
        raise Stopped("its time limit" if name == "SIGALRM" else name)

    before = {
        number: signal.signal(number, stop) for number in signal_numbers("SIGTERM", "SIGUSR1", "SIGALRM")
    }
    if time_limit and hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, time_limit)
    try:
        yield
    finally:
        if time_limit and hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Put off the signals that stop a run until a call is over; a second one acts at once.
    Interrupted early, distributed prints a traceback of another thread, and an import may lose Ctrl-C.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = signal_numbers("SIGINT", "SIGTERM", "SIGUSR1", "SIGALRM")
    before = {number: signal.getsignal(number) for number in numbers}
    received: list[int] = []

    def later(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            deliver(number, frame)

    def deliver(number: int, frame: FrameType | None) -> None:
        handler = before[number]
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
