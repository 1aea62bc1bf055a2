"""Set up the processes of a run: threads, memory, and the signals that stop it."""

import ctypes
import functools
import multiprocessing
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType
from typing import Any

from wavefield.errors import StoreError

# -- threads and memory

# A step allocates and frees hundreds of arrays of a few MB. If glibc returns their memory to the system each
# time, mapping and clearing pages takes longer than measuring. A float image of 4 Mpx has 16 MB.
_MMAP_THRESHOLD, _TRIM_THRESHOLD = 64_000_000, 256_000_000  # bytes
WORKER_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(_MMAP_THRESHOLD),
    "MALLOC_TRIM_THRESHOLD_": str(_TRIM_THRESHOLD),
    "MALLOC_ARENA_MAX": "1",  # one memory pool for all threads; otherwise each would keep its own
}

PRELOAD = "wavefield.execution.process"  # module that workers import first

# Settings of Dask. A chunk (a range of steps that one task measures) takes minutes, so workers are checked
# less often than by default, which costs 4 % of a core per worker. Chunks are independent: memory is not
# spilled to disk, and a lost worker loses one chunk.
SETTINGS: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": 2,  # a chunk fails if a third worker ends while measuring it
    "distributed.scheduler.worker-saturation": 1.0,  # otherwise waiting chunks would count as failed as well
    # the scheduler runs in the run's process, which may compile for a minute: workers wait so long
    "distributed.scheduler.worker-ttl": "300s",
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.nanny.pre-spawn-environ": WORKER_ENVIRONMENT,
    "distributed.worker.multiprocessing-method": "forkserver" if sys.platform == "linux" else "spawn",
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.monitor-interval": "500ms",
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.limit": "60s",
    "distributed.admin.system-monitor.interval": "2s",
    "distributed.comm.timeouts.connect": "300s",
    "distributed.comm.timeouts.tcp": "60s",
}

_OUT_OF_MEMORY = -4  # of OpenCV's errors


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Context manager: OpenCV uses one thread in the block, because steps are measured in parallel."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def keep_memory() -> None:
    """Let the C library (glibc only) keep the memory of freed arrays for reuse in this process."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library, another system
        return
    for parameter, value in ((-3, _MMAP_THRESHOLD), (-1, _TRIM_THRESHOLD), (-8, 1)):  # of malloc.h
        mallopt(parameter, value)


@functools.cache
def set_up_worker() -> None:
    """Configure this process as a worker, once: one OpenCV thread, memory of freed arrays kept for reuse.
    Except on Windows, multiprocessing starts processes by "fork", so that no named locks are left behind."""
    import cv2

    cv2.setNumThreads(1)
    keep_memory()
    if sys.platform != "win32":  # named locks of libraries such as Blosc would outlive the process
        multiprocessing.set_start_method("fork", force=True)


def dask_setup(worker: Any) -> None:
    """Set up a worker before its first task; Dask calls this when it loads the module in a worker."""
    set_up_worker()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # end at once, not after the chunk is finished
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C stops the run, which ends its workers


def peak_memory() -> int:
    """Return the most memory that this process has used so far, bytes; 0 on Windows."""
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def memory_error(error: Exception) -> StoreError | None:
    """Return a StoreError with a remedy if `error` means that memory ran out, else None."""
    if not isinstance(error, MemoryError) and getattr(error, "code", None) != _OUT_OF_MEMORY:
        return None
    detail = f" ({error})" if str(error) else ""
    return StoreError(
        f"memory ran out: the work needs more than {peak_memory() / 1e9:.2g} GB per worker{detail}; ask for "
        "fewer `workers`, or a smaller `steps_per_block`, in the workflow"
    )


# -- signals


class Stopped(KeyboardInterrupt):
    """Raised in a run that must stop; the text is the cause: "its time limit", or a signal like "SIGTERM"."""


def stopped_by(stop: KeyboardInterrupt) -> str:
    """Return the first words of the message on a run that `stop` ended: "stopped" or "stopped by SIGTERM"."""
    return f"stopped by {stop}" if isinstance(stop, Stopped) else "stopped"


def _numbers(*names: str) -> list[int]:
    """Return the numbers of the named signals; signals that this system lacks are left out."""
    return [getattr(signal, name) for name in names if hasattr(signal, name)]


@contextmanager
def stop_signals(time_limit: float | None = None) -> Iterator[None]:
    """Context manager: raise `Stopped` in the block on SIGTERM, SIGHUP, SIGUSR1 or after `time_limit`, s.
    Slurm can send SIGUSR1 before it ends a job. There is no effect outside the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: object) -> None:
        name = signal.Signals(number).name
        raise Stopped("its time limit" if name == "SIGALRM" else name)

    numbers = _numbers("SIGTERM", "SIGHUP", "SIGUSR1", "SIGALRM")
    heard = [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]  # as by nohup
    before = {number: signal.signal(number, stop) for number in heard}
    timed = time_limit and hasattr(signal, "setitimer")
    if timed:
        signal.setitimer(signal.ITIMER_REAL, float(time_limit or 0.0))
    try:
        yield
    finally:
        if timed:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Context manager: delay signals that stop a run until the block ends or a second signal arrives.
    Without it, interrupting the start of Dask prints tracebacks, and Ctrl-C in an import may be lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {n: signal.getsignal(n) for n in _numbers("SIGINT", "SIGTERM", "SIGUSR1", "SIGALRM")}
    received: list[int] = []

    def deliver(number: int, frame: FrameType | None) -> None:
        handler = before[number]
        if callable(handler):
            handler(number, frame)

    def later(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            deliver(number, frame)

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


@contextmanager
def children_ignore_ctrl_c() -> Iterator[None]:
    """Context manager: processes started in the block ignore SIGINT (Ctrl-C) and SIGUSR1 (from Slurm)."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # its start would unblock the signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _numbers("SIGINT", "SIGUSR1"))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
