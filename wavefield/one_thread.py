"""Run linear algebra on one thread: matrices are small, and results must not depend on threads."""

from __future__ import annotations

import threading
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import threadpoolctl

_lock = threading.Lock()
_state: dict[str, Any] = {"depth": 0, "limits": None}


@contextmanager
def one_thread() -> Generator[None]:
    """Context manager or decorator: linear algebra (BLAS) uses one thread in the whole process.
    The first thread that enters sets the limit, and the last that leaves restores the old one.
    """
    with _lock:
        if not _state["depth"]:
            _take_control()
            # each time, because modules loaded since may have brought another BLAS library
            _state["limits"] = threadpoolctl.threadpool_limits(limits=1, user_api="blas")
        _state["depth"] += 1
    try:
        yield
    finally:
        with _lock:
            _state["depth"] -= 1
            if not _state["depth"]:
                _take_control()
                _state["limits"].restore_original_limits()


def _take_control() -> None:
    """Let this thread set limits: threadpoolctl 3.8 and later obeys only the first thread that set one."""
    openblas: Any = getattr(threadpoolctl, "OpenBLASController", None)
    if clear := getattr(openblas, "clear_controlling_thread", None):
        clear(force=True)
