"""Run linear algebra on one thread, because matrices are small and results must not depend on threads."""

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
    If several threads enter, the first sets this limit, and the last to leave restores the earlier limit."""
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
    """Allow the calling thread to set the number of BLAS threads.
    From version 3.8 on, threadpoolctl obeys only one thread, so it must forget the earlier one."""
    openblas: Any = getattr(threadpoolctl, "OpenBLASController", None)
    if clear := getattr(openblas, "clear_controlling_thread", None):
        clear(force=True)
