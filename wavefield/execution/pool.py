"""Worker processes of this machine.

They are forked from one process that has imported what they need once for all, and end with their work. One
that dies is replaced and its item done again. Where compiled code made it crash, what is kept of such code is
removed first, once, and new processes compile it again.
"""

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
from wavefield.execution.deferred_signals import deferred_signals
from wavefield.execution.worker_settings import settle_worker

_MOST_DEATHS = 3  # of workers over one item: it is the item
_WORK, _ITEM = b"w", b"i"  # what a message to a worker begins with
_POLL_SECONDS = 1.0  # between checks of the workers' memory
_CRASHES = ("SIGSEGV", "SIGBUS", "SIGILL", "SIGFPE", "SIGABRT")  # what ends a process that runs faulty code

log = logging.getLogger("wavefield.run")


@dataclass(eq=False)
class _Worker:
    process: BaseProcess
    connection: Connection
    index: int | None = None  # of the item that it is at work on
    compiled_anew: bool = False  # it began after kept compiled code had been removed


class Pool:
    """Worker processes, started by `start` or by the first work, ended by `stop` or after their work."""

    def __init__(
        self,
        count: int,
        memory: int | None = None,
        lasting: bool = False,
        preloaded: str = "wavefield.pipeline.worker_imports",
    ) -> None:
        self._count, self._memory, self._lasting, self._preloaded = count, memory, lasting, preloaded
        self._workers: list[_Worker] = []
        self._starter: ThreadPoolExecutor | None = None
        self._started: Future[None] | None = None
        self._cleared = False  # whether kept compiled code was removed
        # the C library's threads and the image of the caller's memory are not what a worker should inherit
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
                self._context.set_forkserver_preload([self._preloaded])
            self._starter = ThreadPoolExecutor(1)
            self._started = self._starter.submit(self._start_all)

    def stop(self) -> None:
        """End the processes, whatever they are doing: a block is written whole or not at all."""
        if self._starter is None:
            return
        with deferred_signals():
            self._starter.shutdown(wait=True)  # or it would start processes that nobody ends
            for worker in self._workers:
                worker.process.terminate()
                worker.connection.close()
            for worker in self._workers:
                worker.process.join(5.0)
                if worker.process.is_alive():
                    worker.process.kill()
                worker.process.join()
        self._workers, self._starter, self._started = [], None, None

    def map_unordered(
        self, work: Callable[[Any], Any], items: Sequence[Any]
    ) -> Generator[tuple[Any, Any], None, None]:
        """Do work for every item, as processes get free, and end them unless they are to last.

        Returns (item, result or exception): As they are done.
        """
        try:
            with deferred_signals():
                self.start()
                assert self._started is not None
                self._started.result()
            yield from self._work_off(pickle.dumps(work), items)
        finally:
            if not self._lasting or any(worker.index is not None for worker in self._workers):
                self.stop()

    def _start_all(self) -> None:
        for _ in range(self._count):
            self._workers.append(self._start_one())

    def _start_one(self) -> _Worker:
        # the process that others are forked from may have read compiled code before it was removed
        context = multiprocessing.get_context("spawn") if self._cleared else self._context
        here, there = context.Pipe()
        process = context.Process(target=_serve, args=(there,), daemon=True)  # type: ignore[attr-defined]
        _start_deaf(context, process)
        there.close()
        return _Worker(process, here, compiled_anew=self._cleared)

    def _work_off(self, work: bytes, items: Sequence[Any]) -> Generator[tuple[Any, Any], None, None]:
        todo, deaths = deque(range(len(items))), Counter[int]()
        for worker in self._workers:
            self._send(worker, _WORK + work)
        while todo or any(worker.index is not None for worker in self._workers):
            for worker in self._workers:
                if worker.index is None and todo:
                    worker.index = todo.popleft()
                    self._send(worker, _ITEM + pickle.dumps(items[worker.index]))
            busy = {worker.connection: worker for worker in self._workers if worker.index is not None}
            ready = connections.wait(list(busy), _POLL_SECONDS if self._memory else None)
            for one in ready:
                worker = busy[one]  # type: ignore[index]
                index = worker.index
                assert index is not None
                try:
                    result = pickle.loads(worker.connection.recv_bytes())
                except (EOFError, OSError):
                    counts = worker.compiled_anew
                    code = self._replace(worker, work)
                    deaths[index] += counts or _crash(code) is None
                    if deaths[index] < _MOST_DEATHS:
                        todo.appendleft(index)
                        continue
                    result = _lost(code, self._memory)
                worker.index = None
                yield items[index], result
            self._end_the_large(busy.values())

    @staticmethod
    def _send(worker: _Worker, message: bytes) -> None:
        with suppress(OSError):  # it is dead, which is seen when it is read from
            worker.connection.send_bytes(message)

    def _replace(self, worker: _Worker, work: bytes) -> int | None:
        """Put a new process in the place of a dead one; returns how that ended."""
        worker.connection.close()
        worker.process.join(5.0)
        code = worker.process.exitcode
        crash = _crash(code)
        if crash and not self._cleared:
            from wavefield.compiled import clear_compiled

            self._cleared = True
            log.warning(
                "a worker crashed in compiled code (%s): removed %d files of compiled code kept by earlier "
                "processes, and going on with new workers, which compile it again (one to two minutes)",
                crash,
                clear_compiled(),
            )
        with deferred_signals():
            new = self._start_one()
        worker.process, worker.connection, worker.index = new.process, new.connection, None
        worker.compiled_anew = new.compiled_anew
        self._send(worker, _WORK + work)
        return code

    def _end_the_large(self, workers: Any) -> None:
        if not self._memory:
            return
        import psutil

        for worker in workers:
            with suppress(psutil.Error):
                if psutil.Process(worker.process.pid).memory_info().rss > self._memory:
                    worker.process.kill()


def _crash(code: int | None) -> str | None:
    """Name of the signal of a process that ended by a crash in compiled code; None if it ended otherwise."""
    name = signal.Signals(-code).name if code is not None and code < 0 else None
    return name if name in _CRASHES else None


def _lost(code: int | None, memory: int | None) -> StoreError:
    crash = _crash(code)
    if crash:
        return StoreError(
            f"the process that worked on it crashed in compiled code ({crash}), {_MOST_DEATHS} times, also "
            "after it was compiled again: a fault of the program, of a library or of the machine's memory; "
            "run the same command again or on another machine, and if it stays, report it"
        )
    if code is not None and code < 0:
        how = f"was ended by {signal.Signals(-code).name}"
    else:
        how = f"ended by itself (exit status {code})"
    from dask.utils import format_bytes

    limit = f" beyond the workflow's `memory` of {format_bytes(memory)}" if memory else ""
    return StoreError(
        f"the process that worked on it {how}, {_MOST_DEATHS} times: if memory ran out{limit}, ask for fewer "
        "`workers` or a smaller `steps_per_block` in the workflow; in a script, call `run` below "
        '`if __name__ == "__main__":`'
    )


def _start_deaf(context: Any, process: BaseProcess) -> None:
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
    """What a worker does: take work, then one item after the other, then other work."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if sys.platform != "win32":
        # locks that libraries make (Blosc's) then have no name that would be left when this process is ended
        multiprocessing.set_start_method("fork", force=True)
    settle_worker()
    work = b""
    try:
        while True:
            message = connection.recv_bytes()
            if message.startswith(_WORK):
                work = message[len(_WORK) :]
            else:
                connection.send_bytes(_attempt(work, message[len(_ITEM) :]))
    except (EOFError, OSError):  # the run is over
        return


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
    """An exception that can travel to another process: exceptions of libraries may not be made for it."""
    error.add_note(f"in a worker process:\n{traceback.format_exc()}")
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(traceback.format_exc())
    return error


def _end_with_parent() -> None:
    """End at once when the run was killed, rather than after this block."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connections.wait([parent.sentinel])
        os._exit(1)
