"""Processes that find targets: how they start, and that they end with the calibration."""

import os
import sys
import threading
from multiprocessing import forkserver, get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.context import BaseContext


def worker_context(preloaded: str) -> BaseContext:
    """How processes that find targets are started: on Linux forked from one that imports `preloaded`
    while the caller does, which halves the time for a few images.
    """
    if sys.platform != "linux":
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload([preloaded])
    forkserver.ensure_running()
    return context


def start_worker() -> None:
    """Settle this process, a worker: one thread, and no longer than the process that started it."""
    import cv2

    cv2.setNumThreads(1)
    leave_with_parent()


def leave_with_parent() -> None:
    """Let this worker end with the process that started it, however that ends (SIGTERM, SIGKILL)."""
    parent = parent_process()
    if parent is not None:
        sentinel = parent.sentinel

        def watch() -> None:
            wait([sentinel])
            os._exit(1)

        threading.Thread(target=watch, daemon=True).start()
