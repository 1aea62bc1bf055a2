"""How a process that measures is set: one thread, freed memory kept, signals left to the run itself."""

import ctypes
import functools
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from wavefield.execution.signals import signal_numbers

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # of malloc.h
_LARGEST_KEPT = 64_000_000  # bytes of an array; an image of 4 Mpx in floats has 16 MB
_MOST_KEPT = 256_000_000  # bytes at the end of the heap


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep OpenCV of this process to one thread for a while, as it is in the workers.
    No kernel of ours asks numba for threads, and what is done with BLAS is too small for it to take several.
    """
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def keep_memory() -> None:
    """Let the C library keep freed arrays for the next ones, within bounds, where it is glibc.
    It cannot be undone: for processes of our own only, which are the workers and the command line.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library, another system
        return
    # a step makes and drops hundreds of arrays of a few MB: handed back each time, their pages are mapped
    # and cleared again, which takes longer than measuring; Dask's nannies ask for the opposite, by
    # MALLOC_TRIM_THRESHOLD_
    mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT)
    mallopt(_M_TRIM_THRESHOLD, _MOST_KEPT)
    mallopt(_M_ARENA_MAX, 1)  # one for all threads, or each would keep its own


@functools.cache
def settle_worker() -> None:
    """Set this process, a worker, once for all; Ctrl-C and Slurm's warning are for the run itself."""
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    keep_memory()
    if threading.current_thread() is threading.main_thread():
        for number in signal_numbers("SIGINT", "SIGUSR1"):
            signal.signal(number, signal.SIG_IGN)
    import cv2

    cv2.setNumThreads(1)
