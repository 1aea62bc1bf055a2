"""Worker processes of this machine.

They are forked from one process that has made the imports, and end with their work. One that dies, or that
a signal suspends, is replaced and its item done again. Where compiled code made it crash, the cache of such
code is cleared first, once, and new processes compile it again.
"""
# concurrent.futures.ProcessPoolExecutor loses all work when one worker dies, hides how it died and which item
# it was at, and leaves its workers running when the parent is killed.

import functools
import logging
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import connection as connections
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, Self

from wavefield.errors import StoreError
from wavefield.execution.memory import kills_for_memory, lost_for_memory, memory_error, spell_need
from wavefield.execution.signals import deferred_signals
from wavefield.execution.worker_settings import settle_worker

MAX_DEATHS = 3  # of workers over one item: it is the item
_WORK, _ITEM = b"w", b"i"  # what a message to a worker begins with
_RESULT, _WARNING = b"r", b"l"  # and one from it
CHECK_S = 1.0  # between checks of the workers' memory and state
SUSPENDED_CHECKS = 10  # in a row that find a worker suspended: one that goes on by itself is left in peace
CRASH_SIGNALS = ("SIGSEGV", "SIGBUS", "SIGILL", "SIGFPE", "SIGABRT")  # of a process that runs faulty code

# what the process that workers are forked from imports: first what sets its environment, then what all need
ENVIRONMENT = "wavefield.execution.worker_environment"
MEASURING = ("wavefield.measurement.measure", "wavefield.pipeline.chunk_worker")

log = logging.getLogger("wavefield.run")


@dataclass(eq=False)
class _Worker:
    process: BaseProcess
    connection: Connection
    index: int | None = None  # of its item
    cache_cleared: bool = False  # before it started
    memory: int = 0  # most that was seen, bytes
    suspended: int = 0  # checks in a row that found it so
    ended_for: str = ""  # "memory" or "suspended", where the pool has ended it


class Pool:
    """Worker processes, started by `start` or by the first work, ended by `stop` or after their work."""

    def __init__(
        self, count: int, memory: int | None = None, lasting: bool = False, imports: Sequence[str] = MEASURING
    ) -> None:
        self._count, self._memory, self._lasting, self._imports = count, memory, lasting, imports
        self._workers: list[_Worker] = []
        self._starter: ThreadPoolExecutor | None = None
        self._started: Future[None] | None = None
        self._cache_cleared = False
        self._memory_kills = kills_for_memory()
        # a plain fork would inherit the C library's threads and the caller's memory
        method = "forkserver" if sys.platform == "linux" else "spawn"
        self._context = multiprocessing.get_context(method)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start the processes, without waiting for them."""
        if self._started is None:
            if self._context.get_start_method() == "forkserver":
                self._context.set_forkserver_preload([ENVIRONMENT, *self._imports])
            self._starter = ThreadPoolExecutor(1)
            self._started = self._starter.submit(self._start_all)

    def stop(self) -> None:
        """End the processes, whatever they are doing: writing a chunk is atomic."""
        if self._starter is None:
            return
        with deferred_signals():
            self._starter.shutdown(wait=True)  # or it would start processes later
            for worker in self._workers:
                worker.process.terminate()
                worker.connection.close()
            for worker in self._workers:
                worker.process.join(5.0)
                if worker.process.is_alive():
                    worker.process.kill()
                worker.process.join(5.0)  # one that a file system holds may not end at all
        self._workers, self._starter, self._started = [], None, None

    def map_unordered(
        self, work: Callable[[Any], object], items: Sequence[object]
    ) -> Generator[tuple[Any, Any], None, None]:
        """Do work for every item; yields (item, result or exception) as they are done.
        Ends the processes, unless they are to last.
        """
        try:
            with deferred_signals():
                self.start()
                assert self._started is not None
                self._started.result()
            # in a thread: a worker that is suspended while it sends holds up who receives
            over = threading.Event()
            threading.Thread(target=self._check_workers, args=(over,), daemon=True).start()
            try:
                yield from self._work_off(pickle.dumps(work), items)
            finally:
                over.set()
        finally:
            if not self._lasting or any(worker.index is not None for worker in self._workers):
                self.stop()

    def _start_all(self) -> None:
        self._workers += [self._start_one() for _ in range(self._count)]

    def _start_one(self) -> _Worker:
        # the process that others are forked from may have read faulty compiled code
        context: Any = multiprocessing.get_context("spawn") if self._cache_cleared else self._context
        here, there = context.Pipe()
        process = context.Process(target=_serve, args=(there,), daemon=True)
        _start_ignoring_signals(context, process)
        there.close()
        return _Worker(process, here, cache_cleared=self._cache_cleared)

    def _work_off(self, work: bytes, items: Sequence[object]) -> Generator[tuple[Any, Any], None, None]:
        todo, deaths = deque(range(len(items))), Counter[int]()
        for worker in self._workers:
            self._send(worker, _WORK + work)
        while todo or any(worker.index is not None for worker in self._workers):
            for worker in self._workers:
                if worker.index is None and todo:
                    worker.index = todo.popleft()
                    self._send(worker, _ITEM + pickle.dumps(items[worker.index]))
            busy = {worker.connection: worker for worker in self._workers if worker.index is not None}
            ready = connections.wait(list(busy))
            for worker in [busy[one] for one in busy if one in ready]:
                index = worker.index
                assert index is not None
                try:
                    message = worker.connection.recv_bytes()
                except (EOFError, OSError):
                    cache_cleared = worker.cache_cleared
                    code, error = self._replace(worker, work)
                    deaths[index] += cache_cleared or _crash(code) is None
                    if deaths[index] < MAX_DEATHS:
                        todo.appendleft(index)
                        continue
                    result: Any = error
                else:
                    if message.startswith(_WARNING):
                        log.warning("%s", message[len(_WARNING) :].decode())
                        continue
                    result = pickle.loads(message[len(_RESULT) :])
                worker.index = None
                yield items[index], result

    @staticmethod
    def _send(worker: _Worker, message: bytes) -> None:
        with suppress(OSError):  # it is dead, which `_work_off` handles
            worker.connection.send_bytes(message)

    def _replace(self, worker: _Worker, work: bytes) -> tuple[int | None, StoreError]:
        """Replace a dead process; returns its exit code, and the error for its item if that is given up."""
        worker.connection.close()
        worker.process.join(5.0)
        code = worker.process.exitcode
        crash = _crash(code)
        error = self._lost(worker, code)
        if not crash:
            log.warning(
                "a worker (process %s) %s; another takes its place", worker.process.pid, _how(worker, code)
            )
        if crash and not self._cache_cleared:
            from wavefield.compiled import clear_compiled

            self._cache_cleared = True
            log.warning(
                "a worker crashed in compiled code (%s): removed %d files of compiled code kept by earlier "
                "processes, and continuing with new workers, which compile it again (one to two minutes)",
                crash,
                clear_compiled(),
            )
        with deferred_signals():
            new = self._start_one()
        self._workers[self._workers.index(worker)] = new
        self._send(new, _WORK + work)
        return code, error

    def _check_workers(self, over: threading.Event) -> None:
        """End workers that take too much memory, or that were suspended and are not continued."""
        import psutil

        while not over.wait(CHECK_S):
            for worker in [one for one in self._workers if not one.ended_for]:
                with suppress(psutil.Error):
                    process = psutil.Process(worker.process.pid)
                    worker.memory = max(worker.memory, process.memory_info().rss)
                    suspended = process.status() in (psutil.STATUS_STOPPED, psutil.STATUS_TRACING_STOP)
                    worker.suspended = worker.suspended + 1 if suspended else 0
                    if self._memory and worker.memory > self._memory:
                        worker.ended_for = "memory"
                    elif worker.suspended >= SUSPENDED_CHECKS:
                        worker.ended_for = "suspended"
                    if worker.ended_for:
                        process.kill()

    def _lost(self, worker: _Worker, code: int | None) -> StoreError:
        """The error for an item over which workers died, this one last."""
        if crash := _crash(code):
            return StoreError(
                f"the process that worked on it crashed in compiled code ({crash}), {MAX_DEATHS} times, also "
                "after it was compiled again: a fault of the program, of a library or of the machine's "
                "memory; run the same command again or on another machine, and if it stays, report it"
            )
        need = spell_need(worker.memory)
        if worker.ended_for == "memory" and self._memory:
            return StoreError(
                f"the work {need}, more than the workflow's `memory` of {self._memory / 1e9:.2g} GB: give "
                "more `memory`, or a smaller `steps_per_block`, in the workflow"
            )
        if worker.ended_for:
            return StoreError(
                f"the process that worked on it {_how(worker, code)}, {MAX_DEATHS} times: find out what "
                "suspends it, and run the same command again"
            )
        if code == -signal.SIGKILL and kills_for_memory() > self._memory_kills:
            return lost_for_memory(worker.memory, MAX_DEATHS)
        taken = f" (the work {need})" if worker.memory else ""
        return StoreError(
            f"the process that worked on it {_how(worker, code)}, {MAX_DEATHS} times: if memory ran out"
            f"{taken}, ask for fewer `workers` or a smaller `steps_per_block` in the workflow; in a script, "
            'call `run` below `if __name__ == "__main__":`'
        )


def _how(worker: _Worker, code: int | None) -> str:
    """How a worker came to its end, for a sentence."""
    if worker.ended_for == "memory":
        return f"took {worker.memory / 1e9:.2g} GB, more than it may"
    if worker.ended_for:
        return f"was suspended by a signal for {SUSPENDED_CHECKS * CHECK_S:.0f} s"
    if code is not None and code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    return f"ended by itself (exit status {code})"


def _crash(code: int | None) -> str | None:
    """Name of the signal of a process that ended by a crash in compiled code; None if it ended otherwise."""
    name = signal.Signals(-code).name if code is not None and code < 0 else None
    return name if name in CRASH_SIGNALS else None


def _start_ignoring_signals(context: Any, process: BaseProcess) -> None:
    """Start a process that ignores Ctrl-C and Slurm's warning, also while it imports."""
    if not hasattr(signal, "pthread_sigmask"):
        process.start()
        return
    context.Lock()  # starts the tracker of resources, which would let the signals through again
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGUSR1))
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _serve(connection: Connection) -> None:
    """Loop of a worker: receives work, then items, then perhaps other work."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if sys.platform != "win32":
        # locks of libraries (Blosc's) then have no name, which would remain when this process is ended
        multiprocessing.set_start_method("fork", force=True)
    settle_worker()
    handler = _ToParent(connection)
    logging.getLogger("wavefield").addHandler(handler)
    work = b""
    try:
        while True:
            message = connection.recv_bytes()
            if message.startswith(_WORK):
                work = message[len(_WORK) :]
            else:
                handler.send(_RESULT + _attempt(work, message[len(_ITEM) :]))
    except (EOFError, OSError):  # the run is over
        return


class _ToParent(logging.Handler):
    """Sends warnings of a worker, and its results, to the run, which has the log and the terminal."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(logging.WARNING)
        self._connection, self._sending = connection, threading.Lock()

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):
            self.send(_WARNING + self.format(record).encode())

    def send(self, message: bytes) -> None:
        with self._sending:
            self._connection.send_bytes(message)


@functools.lru_cache(maxsize=1)
def _unpacked(work: bytes) -> Callable[[Any], Any]:
    out: Callable[[Any], Any] = pickle.loads(work)
    return out


def _attempt(work: bytes, item: bytes) -> bytes:
    try:
        return pickle.dumps(_unpacked(work)(pickle.loads(item)))
    except Exception as error:
        return pickle.dumps(portable(error))


def portable(error: Exception) -> Exception:
    """An exception that can be pickled, which those of libraries often cannot."""
    if out_of_memory := memory_error(error):
        return out_of_memory
    error.add_note(f"in a worker process:\n{traceback.format_exc()}")
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(traceback.format_exc())
    return error


def _end_with_parent() -> None:
    """End at once when the run was killed, rather than after this chunk."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connections.wait([parent.sentinel])
        os._exit(1)
